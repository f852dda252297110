/** The numbers of a node in the codes of a run, cell by cell: columns of bases, then the core. */

import { type Coder, UNARY, WHOLE } from "./coder";
import { BASIS_CLASSES, type Contexts, NEIGHBOURS, NEIGHBOUR_CLASSES, SIGN_CLASSES } from "./contexts";
import { Cores, LAST_NEIGHBOURS, MOST_SHIFT, signOf } from "./cores";
import { fault } from "./reasons";
import type { NodeShape } from "./run";
import type { Arrays } from "./stage";
import { FINEST, columnOf, widenCore } from "./widen";

const ZERO_CLASS = 16;
const POWERS = Float64Array.from({ length: FINEST + 1 }, (_, k) => 2 ** k);

/** The rows of each cluster of a mode, as the places of their entries: those of cluster c from `starts[c]` on. */
class Members {
  starts = new Uint32Array(2);
  places = new Uint32Array(0);

  /** One cluster of all rows. */
  all(rows: number): void {
    this.reserve(rows);
    this.starts[0] = 0;
    this.starts[1] = rows;
    for (let row = 0; row < rows; row += 1) {
      this.places[row] = row;
    }
  }

  /** By the clusters of so many entries from `first` on. */
  sort(entries: Uint16Array, first: number, count: number, clusters: number): void {
    this.reserve(count);
    if (this.starts.length <= clusters) {
      this.starts = new Uint32Array(2 * clusters + 1);
    }
    const { starts, places } = this;
    starts.fill(0, 0, clusters + 1);
    for (let i = 0; i < count; i += 1) {
      starts[entries[first + i]!]! += 1;
    }
    let end = 0;
    for (let c = 0; c <= clusters; c += 1) {
      end += c < clusters ? starts[c]! : 0;
      starts[c] = end;
    }
    for (let i = count - 1; i >= 0; i -= 1) { // backwards, which turns the ends of clusters into their starts
      const cluster = entries[first + i]!;
      starts[cluster]! -= 1;
      places[starts[cluster]!] = i;
    }
  }

  private reserve(count: number): void {
    if (this.places.length < count) {
      this.places = new Uint32Array(count);
    }
  }
}

export class Numbers {
  private readonly cores: Cores;
  private readonly members: Members[];
  private readonly columns: Uint8Array[]; // k by mode
  private core = new Int32Array(0); // of the node
  private column = new Int32Array(0);
  private readonly half = new Float64Array(1);
  private readonly words = new Uint32Array(this.half.buffer);

  constructor(private readonly coder: Coder, private readonly contexts: Contexts) {
    this.cores = new Cores(coder, contexts);
    this.members = contexts.modes.map(() => new Members());
    this.columns = contexts.modes.map(() => new Uint8Array(0));
  }

  /** Read the numbers of node s. */
  read(arrays: Arrays, s: number, shape: NodeShape, where: string): void {
    const { level } = arrays;
    const [first, end] = [level.coreOffset[s]!, level.coreOffset[s + 1]!];
    const [firstCell, endCell] = [level.cellOffset[s]!, level.cellOffset[s + 1]!];
    const size = (end - first) / (endCell - firstCell);
    this.open(arrays, s, shape, end - first);
    const cell = shape.clusters.map(() => 0);
    for (let c = 0; c < endCell - firstCell; c += 1) {
      if (this.hasMembers(shape, cell)) {
        const base = this.bases(arrays, s, shape, cell, c, where);
        this.cores.read(this.core, c * size, this.columns, base);
      }
      for (let n = cell.length - 1; n >= 0 && (cell[n]! += 1) === shape.clusters[n]; n -= 1) {
        cell[n] = 0;
      }
    }
    const power = widenCore(this.core, end - first, level.core, first);
    level.coreScale.fill(Math.fround(arrays.stage.step! * 2 ** power), firstCell, endCell);
  }

  private open({ level }: Arrays, s: number, shape: NodeShape, numbers: number): void {
    this.cores.open(shape);
    if (this.core.length < numbers) {
      this.core = new Int32Array(numbers);
    }
    this.core.fill(0, 0, numbers);
    shape.mixture.forEach((k, n) => {
      if (k > 0) {
        const [rows, clusters] = [shape.rows[n]!, shape.clusters[n]!];
        if (clusters === 1) {
          this.members[n]!.all(rows);
        } else {
          this.members[n]!.sort(level.cluster[n]!, level.clusterOffset[n]![s]!, rows * k, clusters);
        }
        if (this.columns[n]!.length < shape.ranks[n]!) {
          this.columns[n] = new Uint8Array(shape.ranks[n]!);
        }
        if (this.column.length < rows) {
          this.column = new Int32Array(rows);
        }
      }
    });
  }

  private hasMembers({ mixture }: NodeShape, cell: number[]): boolean {
    return mixture.every((k, n) => k === 0 || this.members[n]!.starts[cell[n]! + 1]! > this.members[n]!.starts[cell[n]!]!);
  }

  /** The columns of all modes of cell c; what its core numbers' sizes start from. */
  private bases({ level }: Arrays, s: number, shape: NodeShape, cell: number[], c: number, where: string): number {
    const { clusters, mixture, ranks, rows } = shape;
    const all = product(clusters);
    let [decomposed, energy, whole, first] = [0, 0, 0, -1];
    let after = all; // cells that the modes behind one make
    for (let n = 0; n < mixture.length; n += 1) {
      after /= clusters[n]!;
      if (mixture[n] === 0) {
        whole += 31 - Math.clz32(rows[n]!);
        continue;
      }
      this.readColumns(n, ranks[n]!, first, where);
      if (decomposed === 0) {
        first = this.columns[n]![0]!;
        energy = this.energy(this.columns[n]!, ranks[n]!);
      }
      decomposed += 1;
      const others = Math.floor(c / (after * clusters[n]!)) * after + (c % after); // the cell without this mode
      const step = (all / clusters[n]!) * ranks[n]!;
      const at = level.basisOffset[n]![s]! + others * ranks[n]!;
      const along = clusters[n] === 1 && shape.extents[n]!.length > 1 ? shape.extents[n]!.at(-1)! : 0;
      for (let r = 0; r < ranks[n]!; r += 1) {
        this.readColumn(n, this.columns[n]![r]!, cell[n]!, level.basis[n]!, at + r, step, along);
      }
    }
    return decomposed === 0 ? 0 : -(decomposed - 1) * energy - whole;
  }

  /** k of all columns of a mode; `first` is that of the cell's first column, or -1. */
  private readColumns(n: number, rank: number, first: number, where: string): void {
    const { coder, contexts } = this;
    const columns = this.columns[n]!;
    let before = first;
    for (let r = 0; r < rank; r += 1) {
      if (before < 0) {
        before = coder.whole(contexts.firstColumn);
      } else {
        const folded = coder.whole(contexts.modes[n]!.column + (r > 0 ? WHOLE : 0));
        before -= folded % 2 === 0 ? folded / 2 : -(folded + 1) / 2;
      }
      if (before < 0 || before > FINEST) {
        throw fault("code-range", where, `a column of k = ${before}`, `0 to ${FINEST}`);
      }
      columns[r] = before;
    }
  }

  /** The whole part of log2(sqrt(2) sum 2^k). */
  private energy(columns: Uint8Array, rank: number): number {
    let sum = 0;
    for (let r = 0; r < rank; r += 1) {
      sum += POWERS[columns[r]!]!;
    }
    this.half[0] = Math.SQRT2 * sum;
    return (this.words[1]! >>> 20) - 1023;
  }

  /**
   * A column of the basis of a cluster: numbers at its rows' places times `step` from `first` on. `along`: if the rows
   * lie in several axes, how many the last one has; else 0.
   */
  private readColumn(n: number, k: number, cluster: number, into: Uint16Array, first: number, step: number, along: number): void {
    const { coder, contexts: { basis, basisEscape, basisSign }, column } = this;
    const { starts, places } = this.members[n]!;
    const [from, rows] = [starts[cluster]!, starts[cluster + 1]! - starts[cluster]!];
    const t = k - twiceLog(rows);
    const shift = Math.min(MOST_SHIFT, Math.max(0, (t >> 1) - 3));
    const size = Math.min(BASIS_CLASSES - 1, Math.max(0, t + ZERO_CLASS));
    const context = basis + size * NEIGHBOUR_CLASSES * UNARY;
    const signs = basisSign + (Math.min(size, 63) >> 2);
    const apart = along === 0 ? 2 : along;
    let place = 0; // along the last axis
    let a = 0;
    for (let i = 0; i < rows; i += 1) {
      const hasA = place > 0;
      const hasB = i >= apart;
      a = hasA ? a : 0;
      const b = hasB ? column[i - apart]! : 0;
      const sum = Math.abs(hasA ? a : b) + Math.abs(hasB ? b : a);
      const near = sum >> shift;
      const sign = signs + SIGN_CLASSES * (3 * signOf(a) + signOf(b) + 4);
      a = coder.signed(context + (near < 11 ? NEIGHBOURS[near]! * UNARY : LAST_NEIGHBOURS), basisEscape, shift, sign);
      column[i] = a;
      place = place + 1 === along ? 0 : place + 1;
    }
    this.widen(k, rows, places, from, into, first, step);
  }

  private widen(k: number, rows: number, places: Uint32Array, from: number, into: Uint16Array, first: number, step: number): void {
    const { column } = this;
    const halves = columnOf(k);
    for (let i = 0; i < rows; i += 1) {
      const number = column[i]!;
      if (number !== 0) {
        into[first + places[from + i]! * step] = number < 0 ? halves.half(-number) | 0x8000 : halves.half(number);
      }
    }
  }
}

/** 2 log2 of a number of rows, rounded. */
function twiceLog(rows: number): number {
  if (rows >= 2 ** 26) {
    const square = BigInt(rows) ** 2n;
    const digits = square.toString(2).length - 1;
    return digits + (square ** 2n >= 1n << BigInt(2 * digits + 1) ? 1 : 0);
  }
  const square = rows * rows; // exact, and so is the comparison, as no whole number lies between the root and its float64
  const digits = Math.floor(Math.log2(square));
  return digits + (square >= Math.SQRT2 * 2 ** digits ? 1 : 0);
}

function product(numbers: number[]): number {
  return numbers.reduce((all, each) => all * each, 1);
}
