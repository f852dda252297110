/** The shaders of the Python package, unchanged, and the viewer's own. */

import contract from "../../../python/hmkcta/shaders/contract.wgsl?raw";
import decode from "../../../python/hmkcta/shaders/decode.wgsl?raw";
import display from "../../../python/hmkcta/shaders/display.wgsl?raw";
import gbuffer from "../../../python/hmkcta/shaders/gbuffer.wgsl?raw";
import grid from "../../../python/hmkcta/shaders/grid.wgsl?raw";
import image from "../../../python/hmkcta/shaders/image.wgsl?raw";
import lightfield from "../../../python/hmkcta/shaders/lightfield.wgsl?raw";
import picks from "../../../python/hmkcta/shaders/picks.wgsl?raw";
import svbrdf from "../../../python/hmkcta/shaders/svbrdf.wgsl?raw";
import volume from "../../../python/hmkcta/shaders/volume.wgsl?raw";
import weighted from "../../../python/hmkcta/shaders/weighted.wgsl?raw";
import slice from "./slice.wgsl?raw";

export const SHADERS = { contract, decode, display, gbuffer, grid, image, lightfield, picks, slice, svbrdf, volume, weighted } as const;

/** One shader: the prelude, further generated lines, and files, in this order. */
export function compose(head: string, ...names: (keyof typeof SHADERS)[]): string {
  return [head, ...names.map((name) => SHADERS[name])].join("\n");
}

/** The files of a shader that decodes weighted sums, by the head that goes before them. */
export function pickedFiles(head: string, ...names: (keyof typeof SHADERS)[]): (keyof typeof SHADERS)[] {
  const walk: ["weighted"] | [] = head.includes("fn decode_picked(") ? [] : ["weighted"];
  return ["image", "decode", "picks", ...walk, ...names];
}
