/** The value under the pointer, of slices. */

import type { App } from "../app";
import { decodeElement } from "../decode/element";
import { shownChannels } from "../render/layout";
import { fitted } from "../render/part";
import { colourAxis, sliceSize } from "../render/slices";
import { plain } from "./controls";

/** Where a place of the canvas (0 to 1) is in the array, and what is there; null beside the picture, or of no slices. */
export function readout(app: App, place: [number, number], canvas: HTMLCanvasElement): string | null {
  if (app.kind !== "generic" || app.arrived === 0) {
    return null;
  }
  const { state, metadata } = app;
  const { x, y } = state.slice;
  const [rows, columns] = sliceSize(metadata, state);
  const { scale, offsetX, offsetY } = fitted(rows, columns, canvas.width, canvas.height, state);
  const column = Math.round(offsetX + scale * (place[0] * canvas.width - 0.5));
  const row = Math.round(offsetY + scale * (place[1] * canvas.height - 0.5));
  if (row < 0 || row >= rows || column < 0 || column >= columns) {
    return null;
  }
  const index = state.position.map((at, n) => (n === x ? column : n === y ? row : at));
  const channel = colourAxis(metadata, state);
  const shown = channel === null ? [index] : shownChannels(metadata.axes[channel]!.size).map((c) => index.map((at, n) => (n === channel ? c : at)));
  const values = shown.map((at) => plain(decodeElement(metadata, app.reading.stages, at, state.level), 4));
  const where = metadata.axes.map((axis, n) => (n === channel ? "" : `${axis.name} ${index[n]}`)).filter((part) => part !== "");
  return `${where.join(", ")}: ${values.join(" ")}`;
}
