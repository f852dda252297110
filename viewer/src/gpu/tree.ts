/** What of a model's tree is in the text of its shaders. Twin of `hmkcta.render.tree`. */

import type { LevelBounds, Metadata } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";

/** A model's metadata, and what holds in all its nodes. */
export interface Tree {
  metadata: Metadata;
  undecomposed: number[]; // modes that are undecomposed in every node with numbers
  mixed: number[]; // modes that are so in some of these nodes
  whole: number[]; // modes with C = 1 in every node
  cuts: boolean; // whether there are nodes that add nothing and have children
  uniform: number[]; // stages, from 0, whose nodes with numbers have the ranks and the undecomposed modes of the metadata
  ranks: number[]; // of each mode the largest R of a node in which it is decomposed
}

/** C, K or R (0, 1, 2) of a node in a mode. */
export function shapeOf({ order, shape }: PackedLevel, s: number, which: 0 | 1 | 2, n: number): number {
  return shape[(3 * s + which) * order + n]!;
}

/** Whether a node has numbers: it is neither empty nor a cut. */
export function hasCells(stage: PackedLevel, s: number): boolean {
  return shapeOf(stage, s, 2, 0) > 0;
}

/** What holds in all nodes of a model. */
export function treeOf(metadata: Metadata, stages: PackedLevel[]): Tree {
  const modes = metadata.modeSizes.map((_, n) => n);
  const [own, decomposed, ranks, cut] = [modes.map(() => false), modes.map(() => false), modes.map(() => 0), modes.map(() => false)];
  let [some, cuts] = [false, false];
  for (const stage of stages) {
    for (let s = 0; s < stage.nodes; s += 1) {
      const cells = hasCells(stage, s);
      some ||= cells;
      cuts ||= !cells && shapeOf(stage, s, 0, 0) > 0;
      for (const n of modes) {
        cut[n] ||= shapeOf(stage, s, 0, n) > 1;
        if (cells && shapeOf(stage, s, 1, n) > 0) {
          decomposed[n] = true;
          ranks[n] = Math.max(ranks[n]!, shapeOf(stage, s, 2, n));
        } else if (cells) {
          own[n] = true;
        }
      }
    }
  }
  return {
    metadata, undecomposed: modes.filter((n) => some && !decomposed[n]), mixed: modes.filter((n) => own[n] && decomposed[n]),
    whole: modes.filter((n) => !cut[n]), cuts, ranks, uniform: stages.flatMap((stage, t) => (isUniform(metadata.stages[t]!, stage) ? [t] : [])),
  };
}

/** What is known of the first stages alone, for a shader of these. */
export function firstStages(tree: Tree, count: number): Tree {
  const { metadata, uniform } = tree;
  const stages = metadata.stages.slice(0, count);
  return {
    ...tree, uniform: uniform.filter((t) => t < count),
    metadata: { ...metadata, stages, levels: metadata.levels.filter((level) => stages.includes(level)) },
  };
}

/** The most weights that mode n, of which so many rows are there at once, has in a cell. */
export function mostWeights({ undecomposed, mixed, ranks }: Tree, n: number, rows: number): number {
  return Math.max(ranks[n]!, undecomposed.includes(n) || mixed.includes(n) ? rows : 1);
}

/** Modes that are undecomposed in all nodes of a stage that has numbers. */
export function undecomposedIn({ mixture, ranks }: LevelBounds): number[] {
  return mixture.flatMap((k, n) => (k === 0 && ranks.some((rank) => rank > 0) ? [n] : []));
}

function isUniform({ mixture, ranks }: LevelBounds, stage: PackedLevel): boolean {
  let cuts = false;
  let cells = false;
  for (let s = 0; s < stage.nodes; s += 1) {
    cuts ||= !hasCells(stage, s) && shapeOf(stage, s, 0, 0) > 0;
    cells ||= hasCells(stage, s);
    if (hasCells(stage, s) && ranks.some((rank, n) => rank !== shapeOf(stage, s, 2, n) || (mixture[n] === 0) !== (shapeOf(stage, s, 1, n) === 0))) {
      return false;
    }
  }
  return stage.nodes > 0 && (cells || !cuts);
}
