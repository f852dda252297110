/** The head of a shader that adds up weighted indices, by `weighted.wgsl`. */

import { axisPlaces } from "../decode/element";
import { pickedCells } from "./cellLoops";
import { type Options, colourMode, prelude, rooms } from "./prelude";
import { isSingle, singleCell } from "./singleCell";
import type { Tree } from "./tree";

/** The prelude, and what else such a shader needs if `options` have picks. */
export function pickedPrelude(tree: Tree, pages: number, options: Options): string {
  const { picks, contracted = [] } = options;
  const head = prelude(tree, pages, options);
  if (picks === undefined) {
    return head;
  }
  const { colour, tinted } = colourMode(tree.metadata, options);
  const lines = isSingle(tree) ? singleCell(tree, axisPlaces(tree.metadata), colour, contracted, tinted)
    : pickedCells(tree, rooms(tree.metadata, picks), colour, contracted, tinted);
  return `${head}${lines.join("\n")}\n`;
}
