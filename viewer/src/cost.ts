/** What frames cost, and what one of another size would. */

/** What the last frame took, and what a pixel more would. */
export interface Cost {
  pixels: number;
  milliseconds: number;
  slope: number;
}

/** The cost after a further frame. A frame has a part that pixels do not change, which two sizes tell apart. */
export function measured(before: Cost | null, pixels: number, milliseconds: number): Cost {
  const share = milliseconds / pixels;
  if (before === null || before.pixels === pixels) {
    return { pixels, milliseconds, slope: Math.min(share, before?.slope ?? share) };
  }
  const slope = (milliseconds - before.milliseconds) / (pixels - before.pixels);
  return { pixels, milliseconds, slope: Math.min(share, Math.max(0.2 * share, slope)) };
}

/** Milliseconds of a frame of so many pixels. */
export function predicted(cost: Cost, pixels: number): number {
  return cost.milliseconds + cost.slope * (pixels - cost.pixels);
}
