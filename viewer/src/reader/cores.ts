/** The core of a cell in the codes of a run: its numbers by those beside them. */

import { type Coder, UNARY } from "./coder";
import { CORE_CLASSES, type Contexts, NEIGHBOURS, NEIGHBOUR_CLASSES } from "./contexts";
import type { NodeShape } from "./run";

const ZERO_CLASS = 40;
export const LAST_NEIGHBOURS = (NEIGHBOUR_CLASSES - 1) * UNARY;
export const MOST_SHIFT = 20;

/** An axis of a node's cores: a decomposed mode, or one axis that the rows of an undecomposed mode lie in. */
interface Axis {
  size: number;
  stride: number;
  mode: number;
  isWhole: boolean; // of an undecomposed mode
}

export class Cores {
  private axes: Axis[] = []; // in the order of the numbers
  private order: Axis[] = []; // in that of neighbours, but for the last one of the numbers
  private isSigned = false; // whether signs have models
  private readonly offsets = new Int32Array(256);
  private active = 0;
  // The first two neighbours in undecomposed modes of a row's first number, and of the others: 0 for none.
  private readonly beside = new Int32Array(4);

  constructor(private readonly coder: Coder, private readonly contexts: Contexts) {}

  /** The cores of a node come next. */
  open({ mixture, ranks, rows, extents }: NodeShape): void {
    const byMode = mixture.map((k, mode) => (k > 0 ? [ranks[mode]!] : extents[mode]!)
      .map((size): Axis => ({ size, stride: 0, mode, isWhole: k === 0 })));
    this.axes = byMode.flat();
    this.axes.reduceRight((stride, axis) => {
      axis.stride = stride;
      return stride * axis.size;
    }, 1);
    this.isSigned = rows.some((_, n) => mixture[n] === 0);
    this.order = byMode.flatMap((own) => own.toReversed());
  }

  /** Read a core into `numbers` from `start` on; `columns` are its columns' k by mode, `base` what is added to their sum. */
  read(numbers: Int32Array, start: number, columns: Uint8Array[], base: number): void {
    const { axes } = this;
    const outer = axes.length - 1;
    const inner = axes[outer]!;
    const index = axes.map(() => 0);
    const signs = this.isSigned ? this.contexts.coreSign : -1;
    let at = start;
    for (;;) {
      let t = base;
      for (let d = 0; d < outer; d += 1) {
        const { isWhole, mode } = axes[d]!;
        t += isWhole ? 0 : columns[mode]![index[d]!]!;
      }
      this.look(index, inner);
      this.row(numbers, at, inner.size, t, inner.isWhole ? null : columns[inner.mode]!, signs);
      at += inner.size;
      let d = outer - 1;
      while (d >= 0 && (index[d]! += 1) === axes[d]!.size) {
        index[d] = 0;
        d -= 1;
      }
      if (d < 0) {
        return;
      }
    }
  }

  /** Which neighbours the numbers of a row have in other rows, by how far they lie before them. */
  private look(index: number[], inner: Axis): void {
    const { beside, offsets } = this;
    beside.fill(0);
    this.active = 0;
    let [first, others] = [0, 0];
    for (const axis of this.order) {
      const isInner = axis === inner;
      if (!isInner && index[this.axes.indexOf(axis)] === 0) {
        continue;
      }
      if (!isInner) {
        offsets[this.active] = axis.stride;
        this.active += 1;
      }
      if (axis.isWhole && others < 2) {
        beside[2 + others] = axis.stride;
        others += 1;
      }
      if (axis.isWhole && !isInner && first < 2) {
        beside[first] = axis.stride;
        first += 1;
      }
    }
  }

  /** The numbers of the last axis; `columns`, if it is a decomposed mode's, are the k to add. `signs`: their models, if any. */
  private row(numbers: Int32Array, start: number, size: number, outer: number, columns: Uint8Array | null, signs: number): void {
    const { coder, contexts, offsets, active, beside } = this;
    const { coreEscape } = contexts;
    let shift = shiftOf(outer);
    let context = contexts.core + contextOf(outer);
    let before = 0; // the number before
    for (let j = 0; j < size; j += 1) {
      const at = start + j;
      if (columns !== null) {
        const t = outer + columns[j]!;
        shift = shiftOf(t);
        context = contexts.core + contextOf(t);
      }
      let sum = Math.abs(before);
      for (let i = 0; i < active; i += 1) {
        sum += Math.abs(numbers[at - offsets[i]!]!);
      }
      let sign = -1;
      if (signs >= 0) {
        const pair = j > 0 ? 2 : 0;
        sign = signs + 3 * (1 + signAt(numbers, at, beside[pair]!)) + 1 + signAt(numbers, at, beside[pair + 1]!);
      }
      const near = sum >> shift;
      before = coder.signed(context + (near < 11 ? NEIGHBOURS[near]! * UNARY : LAST_NEIGHBOURS), coreEscape, shift, sign);
      numbers[at] = before;
    }
  }
}

function shiftOf(t: number): number {
  return Math.min(MOST_SHIFT, Math.max(0, (t >> 1) - 3));
}

function contextOf(t: number): number {
  return Math.min(CORE_CLASSES - 1, Math.max(0, t + ZERO_CLASS)) * (NEIGHBOUR_CLASSES * UNARY);
}

/** The sign of the number so far before another; 0 where there is none. */
function signAt(numbers: Int32Array, at: number, before: number): number {
  return before === 0 ? 0 : signOf(numbers[at - before]!);
}

/** -1, 0 or 1. */
export function signOf(number: number): number {
  return (number >> 31) | (-number >>> 31);
}
