/** Which modes it pays to contract: the twin of `hmkcta.render.paying_modes`. */

import { contractable, contractedModes } from "./frameContraction";
import type { Decoder } from "./decoder";
import { type Options, colourMode, rooms } from "./prelude";
import type { Tree } from "./tree";

const GENERAL = 3; // by how much the loops of models of several cells that keep an undecomposed mode are slower than others

/**
 * The modes to contract that make a pixel cost the least: those of the axes `still`, and, where that is less, of `fixed`
 * ones (those of lights that are the same for all pixels) and of the axis of the colours, all of which are wanted.
 */
export function payingModes(decoder: Decoder, options: Options, still: number[], fixed: number[], channel: number | null): number[] {
  const { metadata, stages, tree } = decoder;
  const colours = channel === null || options.channels !== 3 ? [] : [channel];
  const tried = [contractedModes(decoder, still), ...[colours, fixed, [...fixed, ...colours]].map((more) =>
    contractable(metadata, stages, [...still, ...more], more.some((axis) => colours.includes(axis)) ? 3 : 1))];
  const costs = tried.map((contracted) => pixelCost(tree, { ...options, contracted }));
  return tried[costs.indexOf(Math.min(...costs))]!;
}

/**
 * What one weighted sum costs at most, in all cells that its rows can be members of: a multiply-add counts 1, a word
 * read 2, for reading is what decoders wait for.
 */
export function pixelCost(tree: Tree, options: Options): number {
  const { metadata } = tree;
  const { contracted = [] } = options;
  const room = rooms(metadata, options.picks ?? metadata.axes.map(() => 1));
  const { colour, tinted } = colourMode(metadata, options);
  const kept = room.flatMap((_, n) => (contracted.includes(n) ? [] : [n]));
  const nest = [...kept.filter((n) => n === colour), ...kept.filter((n) => n !== colour)];
  const parts = room.map(() => 1);
  let total = 0;
  for (const { clusters, mixture, ranks } of metadata.stages) {
    let [cells, core, product, basis] = [1, 0, 1, 0];
    room.forEach((rows, n) => {
      parts[n]! *= clusters[n]!;
      cells *= Math.min(rows * Math.max(1, mixture[n]!), parts[n]!);
    });
    if (ranks.every((rank) => rank === 0) && clusters.some((c) => c > 0)) {
      continue; // a cut
    }
    for (const n of nest) {
      const whole = mixture[n] === 0;
      const rank = Math.min(ranks[n]!, tree.ranks[n]!);
      const lanes = n === colour ? 3 : 1;
      product *= whole ? room[n]! : rank;
      core += (tinted ? 3 : lanes) * product;
      basis += whole ? 0 : room[n]! * (rank + 2 * Math.ceil(rank / 2));
    }
    total += cells * (core + product * (tinted ? 6 : contracted.length > 0 ? 2 : 1) + basis);
  }
  const oneCell = metadata.stages.length === 1 && parts.every((count) => count === 1);
  return !oneCell && kept.some((n) => tree.undecomposed.includes(n) || tree.mixed.includes(n)) ? GENERAL * total : total;
}
