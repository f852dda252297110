/** Two small files with all that a reader of levels needs, and what their elements are. */

import { halfValues } from "../src/reader/half";
import { type Node, productOf } from "./encoder";
import { type Content, randomContent } from "./files";
import { type Wish, draws, list, widened } from "./trees";

const LEVEL: Wish = { kind: "coded", last: false };
const LAST: Wish = { kind: "coded", last: true };

/** Whether a node has a place at a stage; else random contents are drawn again. */
function content(seed: number, axes: number[][], wishes: Wish[], good: (content: Content) => boolean): Content {
  const draw = draws(seed);
  for (;;) {
    const made = randomContent(draw, axes, wishes);
    if (made.stages.length === wishes.length && good(made)) {
      return made;
    }
  }
}

const hasNumbers = ({ stages }: Content): boolean =>
  stages.every(({ nodes, step, isHalf }) => (step === null && !isHalf) || nodes.some(({ core }) => core.some((number) => number !== 0)));

/** Two modes, two levels, names and units beyond ASCII, inline coordinates; exact at last. */
export function small(): Content {
  const made = content(7, [[4], [3]], [{ ...LEVEL, ranks: 2 }, { ...LAST, ranks: 2 }], hasNumbers);
  return {
    ...made,
    header: {
      ...made.header, kind: "volume", seed: 7, writer: "tests", source: { "made by": "hand" },
      axes: [{ name: "höhe", size: 4, role: "space", unit: "µm", coordinates: [0, 0.5, 1, 2.5] }, { name: "t", size: 3, role: "time" }],
      quality: [{ snr_db: 12.5, rmse: 0.5, max_abs_error: 1 }, { snr_db: null, rmse: 0, max_abs_error: 0 }],
    },
  };
}

/** Four axes in three modes, colour folded into light, a cut before three levels, coordinates in sections. */
export function merged(): Content {
  const wishes: Wish[] = [{ kind: "cut", last: false }, LEVEL, { ...LEVEL, kind: "half" }, LAST];
  const few = ({ stages }: Content): boolean => stages.reduce((sum, { nodes }) => sum + nodes.length, 0) < 30;
  const made = content(3, [[5, 3], [6], [2]], wishes.map((wish) => ({ ...wish, clusters: 2 })), (each) => hasNumbers(each) && few(each));
  const directions = Float32Array.from({ length: 15 }, (_, i) => Math.sin(i));
  return {
    ...made, coordinates: [new Uint8Array(directions.buffer), new Uint8Array(Float64Array.of(0, 0.04).buffer)],
    header: {
      ...made.header, kind: "svbrdf", dtype: "float16",
      axes: [{ name: "light", size: 5, role: "light", coordinates: { dtype: "F32", width: 3 }, unit: "unit vectors" },
        { name: "texel", size: 6, role: "space" }, { name: "frame", size: 2, role: "time", coordinates: { dtype: "F64", width: 0 } },
        { name: "rgb", size: 3, role: "channel" }],
      organisation: [[0, 3], [1], [2]],
    },
  };
}

/** The element with these rows up to each stage, in the domain of the value transform. */
export function elementOf({ stages }: Content, rows: number[]): number[] {
  let [s, pos, value] = [0, rows, 0];
  let ended = false;
  return stages.map(({ nodes, step, isHalf, stored }) => {
    const node = nodes[s]!;
    if (!ended && node.kind === "cells") {
      const coded = isHalf ? stored![s]! : widened(node, step!);
      value += cellsOf(node, pos, coded.core, coded.basis, [coded.scale].flat());
    }
    ended ||= node.part[0] == null;
    if (!ended) {
      const parts = node.part.map((part, n) => part![pos[n]!]!);
      const before = nodes.slice(0, s).reduce((sum, each) => sum + (each.part[0] == null ? 0 : productOf(each.clusters)), 0);
      pos = node.part.map((part, n) => part!.slice(0, pos[n]!).filter((each) => each === parts[n]).length);
      s = before + parts.reduce((at, part, n) => at * node.clusters[n]! + part, 0);
    }
    return value;
  });
}

function cellsOf(node: Node, pos: number[], core: number[], basis: number[][], scales: number[]): number {
  const half = halfValues();
  const { clusters, mixture, ranks } = node;
  const choices = mixture.map((k) => Math.max(1, k));
  let value = 0;
  for (let choice = 0; choice < productOf(choices); choice += 1) {
    const own = choices.map((count, n) => Math.floor(choice / productOf(choices.slice(n + 1))) % count);
    const cell = own.map((j, n) => node.cluster[n]![pos[n]!]?.[j] ?? 0);
    const flat = (without: number): number => cell.reduce((at, c, n) => (n === without ? at : at * clusters[n]! + c), 0);
    const size = productOf(ranks);
    let sum = 0;
    for (let i = 0; i < size; i += 1) {
      const index = ranks.map((rank, n) => Math.floor(i / productOf(ranks.slice(n + 1))) % rank);
      const weights = index.map((r, n) => {
        if (mixture[n] === 0) {
          return r === pos[n] ? 1 : 0;
        }
        const entry = (pos[n]! * mixture[n]! + own[n]!) * (productOf(clusters) / clusters[n]!) + flat(n);
        return half[basis[n]![entry * ranks[n]! + r]!]!;
      });
      sum += half[core[flat(-1) * size + i]!]! * productOf(weights);
    }
    value += (scales.length > 1 ? scales[flat(-1)]! : scales[0]!) * sum;
  }
  return value;
}

/** Some places of a model. */
export function someRows(sizes: number[], count = 24): number[][] {
  const draw = draws(11);
  return list(count, () => sizes.map((size) => draw(size)));
}
