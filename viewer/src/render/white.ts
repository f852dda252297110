/** What shows as white, by the type of the source: the twin of `hmkcta.render.white`. */

import type { Axis, FileKind } from "../reader/metadata";

/** The largest number of the types that pictures come in. */
const WHITE: Record<string, number> = { bool: 1, uint8: 255, uint16: 65535 };

/** The white of integer pictures; null: their values say it, as they do of measured volumes, and of all other types. */
export function whiteOf(sourceDtype: string, kind: FileKind, axes: readonly Axis[]): number | null {
  const space = axes.filter(({ role }) => role === "space").length;
  const picture = kind === "svbrdf" || kind === "lightfield" || (kind === "generic" && space < 3);
  return picture ? WHITE[sourceDtype] ?? null : null;
}

/** The type whose values are coded by sRGB's curve: of more bits they are mostly light. */
export function isCoded(sourceDtype: string): boolean {
  return sourceDtype === "uint8";
}

/** The white by which sRGB-coded values of a material are decoded to light. */
export function codedWhite(sourceDtype: string): number {
  return WHITE[sourceDtype] ?? 1;
}
