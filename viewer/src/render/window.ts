/** Which values are shown as black and white, and how much errors are amplified, where it is not chosen. */

import type { ValueRange } from "../decode/element";
import type { FileKind, LevelQuality, Metadata } from "../reader/metadata";
import type { State } from "../state";
import { whiteOf } from "./white";

/** What of the page's state decides it. */
interface Seen {
  kind: FileKind;
  metadata: Pick<Metadata, "sourceDtype" | "axes"> & { quality: LevelQuality[] };
  state: State;
}

/** Errors of so many RMSE show as the last of the colours: about 99 of 100 are smaller. */
const TYPICAL = 2.6;
/** Powers of two that the slider of the amplification reaches. */
export const [LEAST_GAIN, MOST_GAIN] = [-2, 12];

/** The high end of a window, above its low end as float32 numbers, too, which shaders take. */
export function windowEnd(low: number, high: number): number {
  return Math.fround(high) > Math.fround(low) ? high : low + Math.max(1, Math.abs(low));
}

/** The white of a light field or a material. */
export function ownWhite({ kind, metadata: { sourceDtype, axes } }: Seen, { high }: ValueRange): number {
  return whiteOf(sourceDtype, kind, axes) ?? (high > 0 ? high : 1);
}

/** The window that `hmkcta render` has. Data of one value is as bright as it is beside 0. */
export function startWindow(
  { metadata: { sourceDtype, axes }, state: { slice } }: Seen, { low, high }: ValueRange, of: "slice" | "volume",
): { low: number; high: number } {
  const white = of === "slice" ? whiteOf(sourceDtype, "generic", axes) : null;
  if (white !== null) {
    return { low: 0, high: white };
  }
  const first = of === "slice" && (slice.colour || low === high) ? Math.min(0, low) : low;
  return { low: first, high: windowEnd(first, high) };
}

/** The values that sliders go from and to: all that were seen, half a window more on either side, and the type's white. */
export function windowBounds({ low, high, least, most }: ValueRange, white: number | null = null): [from: number, to: number] {
  const more = low < high ? (high - low) / 2 : Math.max(1, Math.abs(low));
  return [Math.min(least, low - more), Math.max(most, high + more, white ?? most)];
}

/** The difference that shows as white against black, in the units of the source; of a volume's picture, whose colours are no values, 1. */
export function span({ kind, state: { slice, tone } }: Seen): number {
  return kind === "generic" ? windowEnd(slice.low, slice.high) - slice.low : kind === "volume" ? 1 : tone.white;
}

/**
 * The power of two that amplifies errors. It follows from the errors that the file tells of its levels, not from the
 * picture: the same colour stands for the same error wherever one looks.
 */
export function ownGain(seen: Seen): number {
  const { kind, metadata: { quality }, state: { level, compare, volume } } = seen;
  const rmse = Math.max(...[level, compare.level ?? level].map((each) => quality[each - 1]!.rmse));
  const values = kind === "volume" ? windowEnd(volume.low, volume.high) - volume.low : span(seen);
  const power = rmse > 0 ? Math.round(Math.log2(values / (TYPICAL * rmse))) : 0;
  return 2 ** Math.min(MOST_GAIN, Math.max(LEAST_GAIN, power));
}
