/** What the page's address says. */

import { Problem } from "../problem";

/** A parameter; one that is empty says as much as none. */
export function given(parameters: URLSearchParams, name: string): string | null {
  return parameters.get(name) || null;
}

/** Width and height that `pixels` fixes for a picture of up to `most` a side; null: they are the page's. */
export function fixedSize(pixels: string | null, most: number): [number, number] | null {
  if (pixels === null) {
    return null;
  }
  const [, width, height] = /^(\d+)x(\d+)$/.exec(pixels)?.map(Number) ?? [];
  if (width === undefined || height === undefined || Math.min(width, height) < 1 || Math.max(width, height) > most) {
    throw new Problem("The address asks for a picture of a size that cannot be.",
      `pixels: found ${pixels}, allowed 1x1 to ${most}x${most} on this graphics adapter.`,
      "Give WIDTHxHEIGHT, as in &pixels=640x480, or leave it out.");
  }
  return [width, height];
}
