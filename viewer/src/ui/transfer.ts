/** Editor of a transfer function: opacity over the window, points moved by pointer or arrow keys. */

import { type Point, gradient } from "../render/colours";
import { type Control, make } from "./controls";

const [WIDTH, HEIGHT] = [100, 60];
const STEP = 0.02;
const STEPS: Record<string, Point> = {
  ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP],
};
const MOST_POINTS = 12;
const SVG = "http://www.w3.org/2000/svg";

/** Opacities are drawn by their square roots: the small ones are what matters. */
function drawn(opacity: number): number {
  return Math.sqrt(opacity);
}

/** The editor of what `get` gives and `set` takes, above the colours of the same values. */
export function transferEditor(get: () => Point[], set: (points: Point[]) => void, colours: () => string): Control {
  return new TransferEditor(get, set, colours);
}

class TransferEditor implements Control {
  readonly element: HTMLElement;
  private readonly curve = document.createElementNS(SVG, "path");
  private readonly svg = document.createElementNS(SVG, "svg");
  private readonly ramp = make("div", { class: "ramp" });
  private knobs: HTMLButtonElement[] = [];

  constructor(
    private readonly get: () => Point[], private readonly set: (points: Point[]) => void,
    private readonly colours: () => string,
  ) {
    this.curve.setAttribute("class", "curve");
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    this.svg.setAttribute("preserveAspectRatio", "none");
    this.svg.setAttribute("aria-hidden", "true");
    this.svg.append(this.curve);
    this.element = make("div", { class: "transfer", role: "group", "aria-label": "Opacity over the values" },
      this.svg, this.ramp);
    this.svg.addEventListener("pointerdown", (event) => {
      if (this.get().length < MOST_POINTS) {
        const added = this.add(this.place(event));
        this.knobs[added]!.setPointerCapture(event.pointerId); // a drag goes on with the new point
      }
    });
  }

  refresh(): void {
    const points = this.get();
    if (this.knobs.length !== points.length) {
      this.knobs.forEach((knob) => knob.remove());
      this.knobs = points.map((_, i) => this.makeKnob(i));
      this.element.append(...this.knobs);
    }
    const height = this.svg.clientHeight || 84;
    points.forEach(([share, opacity], i) => {
      const knob = this.knobs[i]!;
      knob.style.left = `${100 * share}%`;
      knob.style.top = `${height * (1 - drawn(opacity))}px`;
      knob.setAttribute("aria-label", `Point ${i + 1}: value ${Math.round(100 * share)} %, `
        + `opacity ${(100 * opacity).toFixed(1)} %. ` + (i > 0 && i < points.length - 1
        ? "Arrow keys move it, Delete removes it, Enter adds one." : "Up and down arrow keys move it, Enter adds one."));
    });
    const path = points.map(([share, opacity]) => `${WIDTH * share} ${HEIGHT * (1 - drawn(opacity))}`).join(" L ");
    this.curve.setAttribute("d", `M 0 ${HEIGHT} L ${path} L ${WIDTH} ${HEIGHT} Z`);
    this.ramp.style.background = gradient(this.colours());
  }

  /** Add a point between the first and the last one; returns its number. */
  private add(point: Point): number {
    const points = this.get();
    const after = points.findIndex(([share]) => share > point[0]);
    const at = Math.max(1, after < 0 ? points.length - 1 : after);
    this.change([...points.slice(0, at), point, ...points.slice(at)]);
    return at;
  }

  /** Add a point halfway to the next one, of the last one to the one before, and go on with it. */
  private addBeside(i: number): void {
    const points = this.get();
    if (points.length < MOST_POINTS) {
      const [one, other] = [points[i]!, points[i + 1] ?? points[i - 1]!];
      const added = this.add([(one[0] + other[0]) / 2, (one[1] + other[1]) / 2]);
      this.knobs[added]?.focus();
    }
  }

  private change(points: Point[]): void {
    this.set(points);
    this.refresh();
  }

  /** Put a point elsewhere, between its neighbours; the first and the last one keep their share. */
  private move(i: number, share: number, opacity: number): void {
    const points = this.get().map((point): Point => [...point]);
    const [low, high] = i === 0 ? [0, 0] : i === points.length - 1 ? [1, 1] : [points[i - 1]![0], points[i + 1]![0]];
    points[i] = [Math.min(high, Math.max(low, share)), Math.min(1, Math.max(0, opacity))];
    this.change(points);
  }

  private remove(i: number): void {
    const points = this.get();
    if (i > 0 && i < points.length - 1) {
      this.change(points.filter((_, n) => n !== i));
      this.knobs[i - 1]?.focus();
    }
  }

  private place(event: PointerEvent): Point {
    const box = this.svg.getBoundingClientRect();
    const height = 1 - (event.clientY - box.top) / box.height;
    return [(event.clientX - box.left) / box.width, Math.min(1, Math.max(0, height)) ** 2];
  }

  private makeKnob(i: number): HTMLButtonElement {
    const knob = make("button", { type: "button", class: "knob" });
    knob.addEventListener("pointerdown", (event) => {
      knob.setPointerCapture(event.pointerId);
    });
    knob.addEventListener("pointermove", (event) => {
      if (knob.hasPointerCapture(event.pointerId)) {
        this.move(i, ...this.place(event));
      }
    });
    knob.addEventListener("dblclick", () => this.remove(i));
    knob.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (step !== undefined) {
        const [share, opacity] = this.get()[i]!;
        this.move(i, share + step[0], Math.max(0, drawn(opacity) + step[1]) ** 2);
        event.preventDefault();
      }
      if (event.key === "Enter" || event.key === "Insert") {
        event.preventDefault();
        this.addBeside(i);
      }
      if (event.key === "Delete" || event.key === "Backspace") {
        this.remove(i);
      }
    });
    return knob;
  }
}
