/** What is chosen on the page: everything that mouse, touch, keyboard and panel change. `store.ts` changes it. */

import type { Point } from "./render/colours";
import type { Shape } from "./render/mesh";
import type { Camera, Vector } from "./render/vector";

export const BACKGROUND: Vector = [0.055, 0.06, 0.07];

export interface Light {
  point: boolean; // else directional
  azimuth: number; // degrees
  elevation: number;
  distance: number; // of a point light
  colour: Vector;
  intensity: number;
}

type CompareMode = "none" | "split" | "heat";
export type Curve = "linear" | "reinhard" | "filmic";
type VolumeMode = "emission" | "shaded" | "iso" | "maximum";

export const CURVES: Curve[] = ["linear", "reinhard", "filmic"];
export const MOST_LIGHTS = 8;
export const MOST_STOPS = 6;
export const VOLUME_MODES: VolumeMode[] = ["emission", "shaded", "iso", "maximum"];

export interface State {
  level: number;
  compare: { mode: CompareMode; level: number | null; position: number; gain: number }; // level null: the original
  own: { gain: boolean; white: boolean; coded: boolean; slice: boolean; volume: boolean }; // what of them, and of windows, is the file's own
  time: number;
  position: number[]; // index of every source axis that nothing else moves along
  tone: { stops: number; curve: Curve; white: number };
  camera: Camera;
  lights: Light[];
  light: number; // which of them pointer, keys and panel change
  surface: { shape: Shape | "mesh"; repeat: number; yUp: boolean; cosine: boolean; coded: boolean };
  view: { row: number; column: number; focus: number; aperture: number };
  zoom: number;
  pan: [number, number]; // in pixels of the picture, of slices and light fields
  slice: { x: number; y: number; colour: boolean; colours: string; low: number; high: number };
  volume: {
    mode: VolumeMode; colours: string; opacity: Point[]; low: number; high: number; iso: number;
    clipLow: Vector; clipHigh: Vector; step: number;
  };
}

export function newLight(azimuth = 60, elevation = 45): Light {
  return { azimuth, elevation, point: false, distance: 3, colour: [1, 1, 1], intensity: 1 };
}

/** The state in which a model is first shown, before anything of the model is known. */
export function newState(axes: number): State {
  return {
    level: 1,
    compare: { mode: "none", level: null, position: 0.5, gain: 1 },
    own: { gain: true, white: true, coded: true, slice: true, volume: true },
    time: 0,
    position: new Array<number>(axes).fill(0),
    tone: { stops: 0, curve: "linear", white: 1 },
    camera: { azimuth: 20, elevation: 20, distance: 3.4, fov: 38, target: [0, 0, 0] },
    lights: [newLight()],
    light: 0,
    surface: { shape: "sphere", repeat: 1, yUp: false, cosine: true, coded: false },
    view: { row: 0, column: 0, focus: 0, aperture: 0 },
    zoom: 1,
    pan: [0, 0],
    slice: { x: 1, y: 0, colour: false, colours: "grey", low: 0, high: 1 },
    volume: {
      mode: "shaded", colours: "inferno", opacity: [[0, 0], [0.15, 0], [1, 0.35]], low: 0, high: 1, iso: 0.5,
      clipLow: [0, 0, 0], clipHigh: [1, 1, 1], step: 0.5,
    },
  };
}
