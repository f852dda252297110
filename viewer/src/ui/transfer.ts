/** Editor of a transfer function: opacity over the window, points moved by pointer or arrow keys. */

import { type Point, gradient } from "../render/colours";
import { type Control, make } from "./controls";

const [WIDTH, HEIGHT] = [100, 60];
const STEP = 0.02;
const MOST_POINTS = 12;

/** Opacities are drawn by their square roots: the small ones are what matters. */
function drawn(opacity: number): number {
  return Math.sqrt(opacity);
}

export function transferEditor(
  get: () => Point[], set: (points: Point[]) => void, colours: () => string,
): Control {
  const curve = document.createElementNS("http://www.w3.org/2000/svg", "path");
  curve.setAttribute("class", "curve");
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("aria-hidden", "true");
  svg.append(curve);
  const ramp = make("div", { class: "ramp" });
  const area = make("div", { class: "transfer", role: "group", "aria-label": "Opacity over the values" }, svg, ramp);
  let knobs: HTMLButtonElement[] = [];

  /** Put a point elsewhere, between its neighbours; the first and the last one keep their share. */
  const move = (i: number, share: number, opacity: number): void => {
    const points = get().map((point): Point => [...point]);
    const low = i === 0 ? 0 : points[i - 1]![0];
    const high = i === points.length - 1 ? 1 : points[i + 1]![0];
    const place = i === 0 ? 0 : i === points.length - 1 ? 1 : Math.min(high, Math.max(low, share));
    points[i] = [place, Math.min(1, Math.max(0, opacity))];
    set(points);
    refresh();
  };

  const remove = (i: number): void => {
    const points = get();
    if (i > 0 && i < points.length - 1) {
      set(points.filter((_, n) => n !== i));
      refresh();
      knobs[i - 1]?.focus();
    }
  };

  const place = (event: PointerEvent): Point => {
    const box = svg.getBoundingClientRect();
    const height = 1 - (event.clientY - box.top) / box.height;
    return [(event.clientX - box.left) / box.width, Math.max(0, height) ** 2];
  };

  const addKnob = (i: number): HTMLButtonElement => {
    const knob = make("button", { type: "button", class: "knob" });
    knob.addEventListener("pointerdown", (event) => {
      knob.setPointerCapture(event.pointerId);
    });
    knob.addEventListener("pointermove", (event) => {
      if (knob.hasPointerCapture(event.pointerId)) {
        move(i, ...place(event));
      }
    });
    knob.addEventListener("dblclick", () => remove(i));
    knob.addEventListener("keydown", (event) => {
      const steps: Record<string, Point> = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
      const step = steps[event.key];
      if (step !== undefined) {
        const [share, opacity] = get()[i]!;
        move(i, share + step[0], Math.max(0, drawn(opacity) + step[1]) ** 2);
        event.preventDefault();
      }
      if (event.key === "Delete" || event.key === "Backspace") {
        remove(i);
      }
    });
    return knob;
  };

  svg.addEventListener("pointerdown", (event) => {
    const points = get();
    if (points.length < MOST_POINTS) {
      set([...points, place(event)].sort((a, b) => a[0] - b[0]));
      refresh();
    }
  });

  const refresh = (): void => {
    const points = get();
    if (knobs.length !== points.length) {
      knobs.forEach((knob) => knob.remove());
      knobs = points.map((_, i) => addKnob(i));
      area.append(...knobs);
    }
    const box = svg.clientHeight || 84;
    points.forEach(([share, opacity], i) => {
      knobs[i]!.style.left = `${100 * share}%`;
      knobs[i]!.style.top = `${box * (1 - drawn(opacity))}px`;
      knobs[i]!.setAttribute("aria-label",
        `Point ${i + 1}: value ${Math.round(100 * share)} %, opacity ${(100 * opacity).toFixed(1)} %. Arrow keys move it, Delete removes it.`);
    });
    const path = points.map(([share, opacity]) => `${WIDTH * share} ${HEIGHT * (1 - drawn(opacity))}`).join(" L ");
    curve.setAttribute("d", `M 0 ${HEIGHT} L ${path} L ${WIDTH} ${HEIGHT} Z`);
    ramp.style.background = gradient(colours());
  };
  return { element: area, refresh };
}
