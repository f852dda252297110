/** The handle between two sides that are compared, on the picture. */

import type { App } from "../app";
import { byId } from "./controls";
import { pictureBox } from "./place";

/** Show it, and what is on either side, where two sides are compared. */
export function placeDivider(app: App, canvas: HTMLCanvasElement): void {
  const { compare, level } = app.state;
  const divider = byId("divider");
  divider.hidden = compare.mode !== "split";
  const [box, stage] = [pictureBox(canvas), canvas.parentElement!.getBoundingClientRect()];
  divider.style.left = `${(100 * (box.left - stage.left + compare.position * box.width)) / stage.width}%`;
  byId("left").textContent = `Level ${Math.min(level, app.arrived)}`;
  byId("right").textContent = compare.level === null ? "Original" : `Level ${compare.level}`;
}

/** Tell where in the picture, from 0 to 1, it is dragged to. */
export function listenToDivider(canvas: HTMLCanvasElement, moved: (position: number) => void): void {
  const divider = byId("divider");
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (divider.hasPointerCapture(event.pointerId)) {
      const box = pictureBox(canvas);
      moved(Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)));
    }
  });
}
