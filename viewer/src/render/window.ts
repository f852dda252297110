/** Which values are shown as the ends of the colours. */

import type { ValueRange } from "../decode/element";
import type { State } from "../state";

/** The high end of a window, above its low end as float32 numbers, too, which shaders take. */
export function windowEnd(low: number, high: number): number {
  return Math.fround(high) > Math.fround(low) ? high : low + Math.max(1, Math.abs(low));
}

/** Begin with the windows that `hmkcta render` has. Data of one value is as bright as it is beside 0. */
export function startWindows({ slice, volume }: State, { low, high }: ValueRange): void {
  slice.low = slice.colour || low === high ? Math.min(0, low) : low;
  slice.high = windowEnd(slice.low, high);
  Object.assign(volume, { low, high: windowEnd(low, high) });
}

/** The values that sliders go from and to: all that were seen, and half a window more on either side. */
export function windowBounds({ low, high, least, most }: ValueRange): [from: number, to: number] {
  const more = low < high ? (high - low) / 2 : Math.max(1, Math.abs(low));
  return [Math.min(least, low - more), Math.max(most, high + more)];
}
