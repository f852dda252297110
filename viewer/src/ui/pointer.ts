/** Mouse, touch and keyboard on the picture. */

import type { App } from "../app";
import { frameOf, showFrame } from "../places";
import { findCameras } from "../render/lightfield";
import { layOut } from "../render/layout";
import { fitted, zoomAbout } from "../render/part";
import { sliceSize } from "../render/slices";
import type { State } from "../state";
import type { Services } from "./groups";
import { pictureBox, placeIn } from "./place";
import { panelShown, showPanel } from "./shown";

const TURN = 0.4; // degrees a pixel
const KEY_STEP = 24; // pixels that an arrow key counts as

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
  private over = false; // the mouse is on the picture, or a finger

  constructor(
    private readonly app: App, private readonly canvas: HTMLCanvasElement, private readonly services: Services,
    private readonly hover: (place: [number, number] | null) => void, signal: AbortSignal,
  ) {
    const options = { signal };
    canvas.addEventListener("pointerdown", (event) => this.down(event), options);
    canvas.addEventListener("pointermove", (event) => this.move(event), options);
    canvas.addEventListener("pointerleave", (event) => {
      this.over = false;
      if (event.pointerType === "mouse") { // what a finger read stays when it is lifted
        this.hover(null);
      }
    }, options);
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

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, event);
    this.point(event);
  }

  private point(event: PointerEvent): void {
    this.over = true;
    this.hover(placeIn(this.canvas, event));
  }

  private move(event: PointerEvent): void {
    const before = this.fingers.get(event.pointerId);
    this.point(event);
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
    const { kind, metadata } = this.app;
    this.app.choose((state) => {
      if (kind === "generic") {
        this.pan(state, x, y);
      } else if (kind === "lightfield") {
        const { last } = findCameras(metadata.axes, layOut(metadata.axes, "lightfield"));
        const share = 1 / Math.max(120, pictureBox(this.canvas).width / 2);
        state.view.column -= x * share * Math.max(1, last[1]);
        state.view.row -= y * share * Math.max(1, last[0]);
      } else {
        state.camera.azimuth -= x * TURN;
        state.camera.elevation += y * TURN;
      }
    });
  }

  private pan(state: State, x: number, y: number): void {
    const { width, height } = pictureBox(this.canvas);
    const { scale } = fitted(...sliceSize(this.app.metadata, state), width, height, state);
    state.pan = [state.pan[0] + x * scale, state.pan[1] + y * scale];
  }

  private moveLight(x: number, y: number): void {
    const { kind } = this.app;
    this.app.choose((state) => {
      if (kind === "generic") {
        this.pan(state, x, y);
      } else if (kind !== "lightfield") {
        const light = state.lights[kind === "volume" ? 0 : state.light]!; // a volume has one
        light.azimuth += x * TURN;
        light.elevation -= y * TURN;
      }
    });
  }

  /** Come nearer; in a picture, what is at a place of it stays there. */
  private zoom(factor: number, place: [number, number] | null = null): void {
    const { kind } = this.app;
    this.app.choose((state) => {
      if (kind === "generic" || kind === "lightfield") {
        const { width, height } = pictureBox(this.canvas);
        zoomAbout(place ?? [0.5, 0.5], factor, pictureSize(this.app), [width, height], state);
      } else {
        state.camera.distance = Math.min(40, Math.max(0.3, state.camera.distance / factor));
      }
    });
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
      : () => {
        (event.shiftKey ? this.moveLight(...arrow) : this.drag(...arrow));
        if (!this.over) {
          this.hover([0.5, 0.5]); // keys point at the middle
        }
      };
    if (act !== undefined) {
      event.preventDefault();
      act();
    }
  }

  private actions(): Record<string, () => void> {
    const { app } = this;
    const { axes } = app.metadata;
    const set = (choose: (state: State) => void) => () => app.choose(choose);
    const level = (step: number): (() => void) => set((state) => {
      state.level += step;
    });
    const frame = (step: number): (() => void) => set((state) => {
      showFrame(axes, app.kind, state, Math.round(frameOf(axes, app.kind, state)) + step);
    });
    const exposure = (step: number): (() => void) => set((state) => {
      state.tone.stops += step;
    });
    const compare = set((state) => {
      const modes = ["none", "split", "heat"] as const;
      state.compare.mode = modes[(modes.indexOf(state.compare.mode) + 1) % 3]!;
    });
    const reset = (): void => app.resetView();
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
