/** Mouse, touch and keyboard on the picture. */

import type { App } from "../app";
import { frameOf, showFrame } from "../places";
import { findCameras } from "../render/lightfield";
import { layOut } from "../render/layout";
import { fitted, zoomAbout } from "../render/part";
import { sliceSize } from "../render/slices";
import type { Services } from "./groups";
import { pictureBox, placeIn } from "./place";
import { panelShown, showPanel } from "./shown";

const TURN = 0.4; // degrees a pixel
const KEY_STEP = 24; // pixels that an arrow key counts as

function clamped(value: number, low: number, high: number): number {
  return Math.min(high, Math.max(low, value));
}

/** Rows and columns of slices, or of a light field. */
function pictureSize({ metadata, kind, state }: App): [number, number] {
  if (kind === "generic") {
    return sliceSize(metadata, state);
  }
  const [y, x] = layOut(metadata.axes, "lightfield").space as [number, number];
  return [metadata.axes[y]!.size, metadata.axes[x]!.size];
}

export class Pointer {
  private readonly fingers = new Map<number, PointerEvent>();

  constructor(
    private readonly app: App, private readonly canvas: HTMLCanvasElement, private readonly services: Services,
    private readonly refresh: () => void, private readonly hover: (place: [number, number] | null) => void,
    signal: AbortSignal,
  ) {
    const options = { signal };
    canvas.addEventListener("pointerdown", (event) => this.down(event), options);
    canvas.addEventListener("pointermove", (event) => this.move(event), options);
    canvas.addEventListener("pointerleave", () => this.hover(null), options);
    for (const type of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(type, (event) => this.fingers.delete(event.pointerId), options);
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault(), options);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode === 0 ? 0.0015 : 0.05)), placeIn(this.canvas, event));
    }, { ...options, passive: false });
    window.addEventListener("keydown", (event) => this.key(event), options);
  }

  private changed(): void {
    this.refresh();
    this.app.redraw();
  }

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, event);
  }

  private move(event: PointerEvent): void {
    const before = this.fingers.get(event.pointerId);
    this.hover(placeIn(this.canvas, event));
    if (before === undefined) {
      return;
    }
    const [x, y] = [event.clientX - before.clientX, event.clientY - before.clientY];
    this.fingers.set(event.pointerId, event);
    if (this.fingers.size === 2) {
      this.pinch(event, before, x / 2, y / 2);
    } else if (event.shiftKey || (event.buttons & 2) !== 0) {
      this.moveLight(x, y);
    } else {
      this.drag(x, y);
    }
  }

  private pinch(event: PointerEvent, before: PointerEvent, x: number, y: number): void {
    const other = [...this.fingers.values()].find((finger) => finger.pointerId !== event.pointerId)!;
    const distance = (finger: PointerEvent): number =>
      Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
    const between = { clientX: (event.clientX + other.clientX) / 2, clientY: (event.clientY + other.clientY) / 2 };
    this.zoom(distance(event) / Math.max(1, distance(before)), placeIn(this.canvas, between));
    this.moveLight(x, y);
  }

  /** Turn the camera, or move the view point or the slice. */
  private drag(x: number, y: number): void {
    const { app } = this;
    const { state } = app;
    if (app.kind === "generic") {
      this.pan(x, y);
    } else if (app.kind === "lightfield") {
      const { last } = findCameras(app.metadata.axes, layOut(app.metadata.axes, "lightfield"));
      const share = 1 / Math.max(120, pictureBox(this.canvas).width / 2);
      state.view.column = clamped(state.view.column - x * share * Math.max(1, last[1]), 0, last[1]);
      state.view.row = clamped(state.view.row - y * share * Math.max(1, last[0]), 0, last[0]);
    } else {
      state.camera.azimuth -= x * TURN;
      state.camera.elevation = clamped(state.camera.elevation + y * TURN, -89.9, 89.9);
    }
    this.changed();
  }

  private pan(x: number, y: number): void {
    const { state, metadata } = this.app;
    const { width, height } = pictureBox(this.canvas);
    const { scale } = fitted(...sliceSize(metadata, state), width, height, state);
    state.pan = [state.pan[0] + x * scale, state.pan[1] + y * scale];
  }

  private moveLight(x: number, y: number): void {
    const { lights, light: chosen } = this.app.state;
    const light = lights[this.app.kind === "volume" ? 0 : chosen]; // a volume has one
    if (this.app.kind === "generic") {
      this.pan(x, y);
    } else if (this.app.kind !== "lightfield" && light !== undefined) {
      light.azimuth += x * TURN;
      light.elevation = clamped(light.elevation - y * TURN, -90, 90);
    }
    this.changed();
  }

  /** Come nearer; in a picture, what is at a place of it stays there. */
  private zoom(factor: number, place: [number, number] | null = null): void {
    const { state, kind } = this.app;
    if (kind === "generic" || kind === "lightfield") {
      const { width, height } = pictureBox(this.canvas);
      zoomAbout(place ?? [0.5, 0.5], factor, pictureSize(this.app), [width, height], state);
    } else {
      state.camera.distance = clamped(state.camera.distance / factor, 0.3, 40);
    }
    this.changed();
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName)
      || (/^(BUTTON|SUMMARY)$/.test(target.tagName) && (event.key === " " || event.key === "Enter" || event.key.startsWith("Arrow")))) {
      return;
    }
    const arrows: Record<string, [number, number]> = {
      ArrowLeft: [-KEY_STEP, 0], ArrowRight: [KEY_STEP, 0], ArrowUp: [0, -KEY_STEP], ArrowDown: [0, KEY_STEP],
    };
    const arrow = arrows[event.key];
    const act = arrow === undefined ? this.actions()[event.key]
      : () => (event.shiftKey ? this.moveLight(...arrow) : this.drag(...arrow));
    if (act !== undefined) {
      event.preventDefault();
      act();
    }
  }

  private actions(): Record<string, () => void> {
    const { app } = this;
    const { state, metadata } = app;
    const set = (change: () => void) => () => {
      change();
      this.changed();
    };
    const level = (step: number): (() => void) => set(() => {
      state.level = clamped(Math.min(state.level, app.arrived) + step, 1, app.arrived);
    });
    const frame = (step: number): (() => void) => set(() => {
      showFrame(metadata.axes, app.kind, state, Math.round(frameOf(metadata.axes, app.kind, state)) + step);
    });
    const exposure = (step: number): (() => void) => set(() => {
      state.tone.stops = clamped(state.tone.stops + step, -6, 6);
    });
    const compare = set(() => {
      if (app.original === null && app.metadata.levels.length === 1) {
        return; // The panel offers nothing to compare with either.
      }
      const modes = ["none", "split", "heat"] as const;
      state.compare.mode = modes[(modes.indexOf(state.compare.mode) + 1) % 3]!;
    });
    const reset = set(() => app.resetView());
    return {
      "+": () => this.zoom(1.2), "=": () => this.zoom(1.2), "-": () => this.zoom(1 / 1.2), "[": level(-1), "]": level(1),
      ",": frame(-1), ".": frame(1), " ": () => this.services.player.toggle(), c: compare, C: compare, e: exposure(0.5),
      E: exposure(-0.5), r: reset, R: reset, s: () => this.services.save(), S: () => this.services.save(),
      "?": () => {
        const keys = document.getElementById("keys");
        const open = !panelShown() || keys?.hasAttribute("open") !== true;
        showPanel(true);
        keys?.toggleAttribute("open", open);
        if (open) {
          keys?.scrollIntoView(); // It is the last of the panel, mostly below what is seen.
        }
      },
    };
  }
}
