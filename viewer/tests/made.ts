/** States of the page that tests begin with. */

import type { Axis, FileKind, Metadata } from "../src/reader/metadata";
import { type Action, type Shown, firstShown, reduced } from "../src/store";

export function axis(name: string, size: number, role: Axis["role"] = "other"): Axis {
  return { name, size, role, coords: null, unit: "" };
}

export const VOLUME = [axis("time", 6, "time"), ...["z", "y", "x"].map((name) => axis(name, 8, "space"))];
export const LIGHTFIELD = [axis("row", 3, "view"), axis("column", 5, "view"), axis("y", 8, "space"), axis("x", 8, "space")];
export const RANGE = { low: 20, high: 180, least: 3, most: 200 };

/** Metadata of three levels of 11.9, 20.3 and 28.3 dB. */
export function metadata(kind: FileKind, axes: Axis[], sourceDtype = "float32"): Metadata {
  const quality = [[11.9, 8], [20.3, 4], [28.3, 0.5]].map(([snrDb, rmse]) => ({ snrDb: snrDb!, rmse: rmse!, maxAbsError: 9 * rmse! }));
  const stages = quality.map(() => ({ clusters: [], mixture: [], ranks: [], scheme: "most" }));
  return {
    kind, axes, sourceDtype, quality, stages, levels: stages, organisation: axes.map(({ name }) => [name]), modeSizes: axes.map(({ size }) => size),
    transform: { name: "identity", scale: 1 }, writer: "",
  };
}

/** A state after some actions, of a file that is shown as its kind. */
export function shown(kind: FileKind, axes: Axis[], actions: Action[] = [], sourceDtype = "float32"): Shown {
  const first = firstShown("some/wood.hmk", metadata(kind, axes, sourceDtype));
  return [{ type: "show-as", kind } as Action, ...actions].reduce(reduced, first);
}
