/**
 * Interpolation among measured directions: a triangulation of the hemisphere as a table that the shader walks.
 * Twin of `hmkcta.render.directions`: stereographic projection, Delaunay, a ring of ghosts around.
 */

import Delaunator from "delaunator";
import { Problem } from "../problem";
import type { Axis } from "../reader/metadata";
import { type Vector, normalised } from "./vector";

const GHOSTS = 32;
const GHOST_RADIUS = 1.25;
export const GRID = 64; // cells a side over p in [-1, 1] squared
const MOST_STEPS = 8; // of the walk from a cell's triangle to the direction's
const NO_NEIGHBOUR = 0xffffffff;
const VIEW_TURN = 1.2; // radians by which assumed views are turned against lights
const GOLDEN_ANGLE = Math.PI * (3 - Math.sqrt(5));
const MAX_ZENITH = (75 * Math.PI) / 180;
const RECORD = 16; // numbers a triangle

/** Triangles over measured directions, as the shader reads them: records, then the grid. */
interface DirectionTable {
  words: Uint32Array<ArrayBuffer>;
  triangles: number;
}

/** Unit vectors of a light or view axis, and whether they are assumed because it has no coordinates. */
export function directionsOf(axis: Axis): { vectors: Vector[]; assumed: boolean } {
  const { coords, size } = axis;
  if (coords === null) {
    return { vectors: hemisphere(size, axis.role === "view" ? VIEW_TURN : 0), assumed: true };
  }
  if (coords.width !== 2 && coords.width !== 3) {
    throw new Problem(`The coordinates of ${axis.name} are no directions.`, `They have ${coords.width} numbers each.`,
      "It is shown as slices.");
  }
  const vectors = Array.from({ length: size }, (_, i): Vector => {
    const row = coords.values.subarray(i * coords.width, (i + 1) * coords.width);
    if (coords.width === 3) {
      return [row[0]!, row[1]!, row[2]!];
    }
    const unit = axis.unit.toLowerCase().includes("deg") ? Math.PI / 180 : 1;
    const [zenith, azimuth] = [row[0]! * unit, row[1]! * unit];
    return [Math.sin(zenith) * Math.cos(azimuth), Math.sin(zenith) * Math.sin(azimuth), Math.cos(zenith)];
  });
  vectors.forEach((vector, i) => {
    const length = Math.hypot(...vector);
    if (!(length > 1e-6 && vector[2] > -0.2 * length)) {
      throw new Problem(`The coordinates of ${axis.name} are no directions above the surface.`, `Row ${i}.`,
        "It is shown as slices.");
    }
  });
  return { vectors: vectors.map(normalised).map(([x, y, z]) => [x, y, Math.max(z, 0)]), assumed: false };
}

/** Unit vectors spread evenly by area from the zenith down: a Fibonacci spiral. */
export function hemisphere(count: number, turn: number): Vector[] {
  return Array.from({ length: count }, (_, i) => {
    const z = 1 - ((i + 0.5) / count) * (1 - Math.cos(MAX_ZENITH));
    const [radius, azimuth] = [Math.sqrt(1 - z * z), i * GOLDEN_ANGLE + turn];
    return [radius * Math.cos(azimuth), radius * Math.sin(azimuth), z];
  });
}

/** The table of unit vectors with z >= 0. */
export function buildTable(vectors: Vector[]): DirectionTable {
  const flat = vectors.map(([x, y, z]): [number, number] => [x / (1 + z), y / (1 + z)]);
  const points = [...flat];
  const standsFor = flat.map((_, i) => i);
  for (let j = 0; j < GHOSTS; j += 1) {
    const angle = (2 * Math.PI * j) / GHOSTS;
    const ghost: [number, number] = [GHOST_RADIUS * Math.cos(angle), GHOST_RADIUS * Math.sin(angle)];
    points.push(ghost);
    standsFor.push(nearest(flat, ghost));
  }
  const { triangles, halfedges } = Delaunator.from(points);
  const count = triangles.length / 3;
  const words = new Uint32Array(RECORD * count + GRID * GRID);
  const floats = new Float32Array(words.buffer);
  for (let t = 0; t < count; t += 1) {
    const corners = [0, 1, 2].map((k) => triangles[3 * t + k]!);
    const ids = corners.map((corner) => standsFor[corner]!);
    const heights = ids.map((id) => vectors[id]![2]);
    const at = RECORD * t;
    words.set(ids, at);
    floats[at + 3] = heights[2]!;
    [0, 1, 2].forEach((k) => {
      const across = halfedges[3 * t + ((k + 1) % 3)]!; // the edge from corner k+1 to k+2 lies opposite corner k
      words[at + 4 + k] = across < 0 ? NO_NEIGHBOUR : Math.floor(across / 3);
    });
    floats.set(affineWeights(corners.map((corner) => points[corner]!)), at + 8);
    floats.set([heights[0]!, heights[1]!], at + 14);
  }
  fillGrid(words, floats, count);
  return { words, triangles: count };
}

/** Measured directions around a local one, their weights, and the height that they interpolate: as the shader finds them. */
export function interpolateDirection({ words, triangles }: DirectionTable, [x, y, z]: Vector): { index: number[]; weight: number[]; height: number } {
  const floats = new Float32Array(words.buffer);
  const p = [x / (1 + Math.max(z, 0)), y / (1 + Math.max(z, 0))] as const;
  const [column, row] = p.map((each) => Math.min(GRID - 1, Math.floor(Math.max(0, (each + 1) * (GRID / 2))))) as [number, number];
  let at = RECORD * words[RECORD * triangles + GRID * row + column]!;
  const barycentric = (): number[] => {
    const affine = (k: number): number => floats[at + k]! * p[0] + floats[at + k + 1]! * p[1] + floats[at + k + 2]!;
    const [one, two] = [affine(8), affine(11)];
    return [one, two, 1 - one - two];
  };
  let weights = barycentric();
  for (let steps = 0; steps < MOST_STEPS; steps += 1) {
    const least = Math.min(...weights);
    const across = words[at + 4 + weights.indexOf(least)]!;
    if (least >= 0 || across === NO_NEIGHBOUR) {
      break;
    }
    at = RECORD * across;
    weights = barycentric();
  }
  const positive = weights.map((each) => Math.max(0, each));
  const weight = positive.map((each) => each / positive.reduce((sum, other) => sum + other));
  const heights = [floats[at + 14]!, floats[at + 15]!, floats[at + 3]!];
  return {
    index: Array.from(words.subarray(at, at + 3)), weight,
    height: weight.reduce((sum, each, k) => sum + each * heights[k]!, 0),
  };
}

function nearest(points: [number, number][], to: [number, number]): number {
  let best = 0;
  points.forEach(([x, y], i) => {
    const [bx, by] = points[best]!;
    best = (x - to[0]) ** 2 + (y - to[1]) ** 2 < (bx - to[0]) ** 2 + (by - to[1]) ** 2 ? i : best;
  });
  return best;
}

/** Weights of corners 0 and 1 as affine functions of p. */
function affineWeights(corners: [number, number][]): number[] {
  const [[x0, y0], [x1, y1], [x2, y2]] = corners as [[number, number], [number, number], [number, number]];
  const found = (y1 - y2) * (x0 - x2) + (x2 - x1) * (y0 - y2);
  const area = Math.abs(found) < 1e-14 ? 1e-14 : found;
  const [a0, b0, a1, b1] = [(y1 - y2) / area, (x2 - x1) / area, (y2 - y0) / area, (x0 - x2) / area];
  return [a0, b0, -(a0 * x2 + b0 * y2), a1, b1, -(a1 * x2 + b1 * y2)];
}

/** The triangle at the centre of each cell, found by walking on from its neighbour's. */
function fillGrid(words: Uint32Array, floats: Float32Array, count: number): void {
  let t = 0;
  for (let cell = 0; cell < GRID * GRID; cell += 1) {
    const [row, column] = [Math.floor(cell / GRID), cell % GRID];
    const [x, y] = [((column + 0.5) * 2) / GRID - 1, ((row + 0.5) * 2) / GRID - 1];
    for (let steps = 0; steps < count; steps += 1) {
      const at = RECORD * t;
      const w0 = floats[at + 8]! * x + floats[at + 9]! * y + floats[at + 10]!;
      const w1 = floats[at + 11]! * x + floats[at + 12]! * y + floats[at + 13]!;
      const weights = [w0, w1, 1 - w0 - w1];
      const least = Math.min(...weights);
      const across = words[at + 4 + weights.indexOf(least)]!;
      if (least >= 0 || across === NO_NEIGHBOUR) {
        break;
      }
      t = across;
    }
    words[RECORD * count + cell] = t;
  }
}
