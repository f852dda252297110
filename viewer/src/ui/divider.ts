/** The handle between two sides that are compared, on the picture. */

import type { App } from "../app";
import { sideNames } from "../figures";
import { byId, tell } from "./controls";
import { pictureBox } from "./place";

const STEP = 1; // percent an arrow key

/** Show it, and what is on either side, where two sides are compared. */
export function placeDivider(app: App, canvas: HTMLCanvasElement): void {
  const { compare } = app.state;
  const divider = byId("divider");
  divider.hidden = compare.mode !== "split";
  const [box, stage] = [pictureBox(canvas), canvas.parentElement!.getBoundingClientRect()];
  divider.style.left = `${(100 * (box.left - stage.left + compare.position * box.width)) / stage.width}%`;
  const percent = Math.round(100 * compare.position);
  divider.setAttribute("aria-valuenow", String(percent));
  divider.setAttribute("aria-valuetext", `${percent} %, ${sideNames(app.shown).join(" and ").toLowerCase()}`);
  sideNames(app.shown).forEach((name, n) => tell(byId(n === 0 ? "left" : "right"), name));
}

/** Tell where in the picture, from 0 to 1, it is dragged to, or moved by keys. */
export function listenToDivider(canvas: HTMLCanvasElement, moved: (position: number) => void): void {
  const divider = byId("divider");
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (divider.hasPointerCapture(event.pointerId)) {
      const box = pictureBox(canvas);
      moved(Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)));
    }
  });  divider.addEventListener("keydown", (event) => {
    const now = Number(divider.getAttribute("aria-valuenow"));
    const to: Record<string, number> = {
      ArrowLeft: now - STEP, ArrowDown: now - STEP, ArrowRight: now + STEP, ArrowUp: now + STEP, PageDown: now - 10, PageUp: now + 10, Home: 0, End: 100,
    };
    const place = to[event.key];
    if (place !== undefined) {
      event.preventDefault();
      event.stopPropagation(); // these keys would move the picture
      moved(place / 100);
    }
  });
}
