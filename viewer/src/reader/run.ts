/** The codes of a run, node by node (`docs/format.md`): kinds and shapes, clusters and parts; `numbers.ts` has the rest. */

import { Coder, LABEL, WHOLE } from "./coder";
import { CELLS, CUT, Contexts, EMPTY, MEMBER_CLASSES, type ModeContexts, RANK_CLASSES } from "./contexts";
import { type Limits, checkLimit } from "./limits";
import { Numbers } from "./numbers";
import { fault } from "./reasons";
import type { Arrays } from "./stage";
import type { Extents, Parts } from "./tree";

/** C, K, R, rows and extents of the node at hand, by mode. */
export interface NodeShape {
  clusters: number[];
  mixture: number[];
  ranks: number[];
  rows: number[];
  extents: number[][];
}

/** Reads the runs of the stages of a file; `open` begins a stage. */
export class RunReader {
  private readonly contexts: Contexts;
  private readonly coder: Coder;
  private readonly numbers: Numbers;
  private readonly modes: ModeContexts[];
  private arrays!: Arrays; // of the stage at hand
  private where = "";
  // What contexts take from the nodes before, of the run.
  private kind = EMPTY;
  private parted = 0;
  private readonly undecomposed: number[];
  private readonly rank: number[];

  constructor(private readonly order: number, private readonly extents: Extents, private readonly limits: Limits) {
    this.contexts = new Contexts(order);
    this.coder = new Coder(this.contexts.size);
    this.numbers = new Numbers(this.coder, this.contexts);
    this.modes = this.contexts.modes;
    this.undecomposed = new Array<number>(order).fill(0);
    this.rank = new Array<number>(order).fill(0);
  }

  /** Read a run: its codes, and how many nodes they are of. */
  read(arrays: Arrays, codes: Uint8Array, nodes: number, where: string): void {
    this.arrays = arrays;
    this.where = where;
    this.coder.begin(codes, where);
    [this.kind, this.parted] = [EMPTY, 0];
    this.undecomposed.fill(0);
    this.rank.fill(0);
    for (let s = 0; s < nodes; s += 1) {
      this.node(arrays.done);
      arrays.done += 1;
    }
    this.coder.finish();
  }

  private node(s: number): void {
    const { children, nodes } = this.arrays;
    const rows = nodes.rows.map((mode) => mode[s]!);
    const kind = rows.includes(0) ? null : this.nodeKind();
    if (kind === null || kind === EMPTY) {
      const none = rows.map(() => 0);
      this.arrays.take(0, 0, none, none);
      children?.none(s);
      return;
    }
    const extents = rows.map((count, n) => this.extents.of(nodes.extents[n]![s]!, count));
    if (kind === CELLS) {
      this.cells(s, rows, extents);
    } else {
      this.cut(s, rows, extents);
    }
  }

  private nodeKind(): number {
    const { coder, contexts } = this;
    const at = contexts.kind + 2 * this.kind;
    const isLast = this.arrays.children === null;
    this.kind = coder.bit(at) === 1 ? CELLS : !isLast && coder.bit(at + 1) === 1 ? CUT : EMPTY;
    return this.kind;
  }

  private setShape(s: number, which: number, values: number[]): void {
    this.arrays.level.shape.set(values, (3 * s + which) * this.order);
  }

  private bounded(what: string, n: number, found: number, most: number): void {
    if (found > most) {
      throw fault("level-bounds", this.where, `${what} of ${found} in mode ${n}`, `at most ${most}, the largest of the stage`);
    }
  }

  private cells(s: number, rows: number[], extents: number[][]): void {
    const { coder, contexts, arrays } = this;
    if (arrays.children !== null) {
      this.parted = coder.bit(contexts.parted + this.parted);
    }
    const shape: NodeShape = { clusters: [], mixture: [], ranks: [], rows, extents };
    for (let n = 0; n < this.order; n += 1) {
      this.modeShape(n, shape);
    }
    const { clusters, mixture, ranks } = shape;
    checkLimit("level-cost-limit", this.where, product(ranks.map((rank, n) => (mixture[n] === 0 ? 1 : mixture[n]! * rank))), this.limits.level_cost);
    [clusters, mixture, ranks].forEach((values, which) => this.setShape(s, which, values));
    const cells = product(clusters);
    const entries = rows.map((count, n) => count * mixture[n]!);
    arrays.take(cells, cells * product(ranks), entries, entries.map((count, n) => count * (cells / clusters[n]!) * ranks[n]!));
    if (arrays.children !== null && this.parted === 1) {
      arrays.children.check(cells, this.where);
    }
    for (let n = 0; n < this.order; n += 1) {
      if (clusters[n]! > 1) {
        this.memberships(s, n, shape);
      }
    }
    if (arrays.children !== null) {
      if (this.parted === 1) {
        this.children(s, shape.clusters.map((count, n) => this.partsOfCells(s, n, count, shape)));
      } else {
        arrays.children.none(s);
      }
    }
    if (arrays.stage.step !== null) {
      this.numbers.read(arrays, s, shape, this.where);
    }
  }

  /** C, K and R of a mode. */
  private modeShape(n: number, { clusters, mixture, ranks, rows }: NodeShape): void {
    const { coder, arrays: { stage } } = this;
    const mode = this.modes[n]!;
    this.undecomposed[n] = coder.bit(mode.undecomposed + this.undecomposed[n]!);
    let [c, k, r] = [1, 0, rows[n]!];
    if (this.undecomposed[n] === 0) {
      c = 1 + coder.whole(mode.clusters);
      this.bounded("C", n, c, stage.clusters[n]!);
      k = c > 1 ? 1 + coder.whole(mode.mixture) : 1;
      this.bounded("K", n, k, stage.mixture[n]!);
      if (k > c) {
        throw fault("node-shape", this.where, `K of ${k} in mode ${n}`, `at most ${c}, which is C`);
      }
      r = 1 + coder.whole(mode.rank + this.rank[n]! * WHOLE);
      this.rank[n] = Math.min(32 - Math.clz32(r), RANK_CLASSES - 1);
    } else {
      this.bounded("C", n, c, stage.clusters[n]!);
    }
    this.bounded("R", n, r, stage.ranks[n]!);
    if (k > 0) {
      checkLimit("rank-limit", this.where, r, this.limits.rank);
    }
    clusters.push(c);
    mixture.push(k);
    ranks.push(r);
  }

  /** The clusters of all rows in a mode. */
  private memberships(s: number, n: number, { clusters, mixture, rows }: NodeShape): void {
    const { coder, arrays: { level } } = this;
    const mode = this.modes[n]!;
    const [count, k, entries] = [clusters[n]!, mixture[n]!, level.cluster[n]!];
    let at = level.clusterOffset[n]![s]!;
    let same = 0;
    for (let row = 0; row < rows[n]!; row += 1, at += k) {
      if (row > 0) {
        same = coder.bit(mode.same + same);
      }
      if (same === 1) {
        entries.copyWithin(at, at - k, at);
        continue;
      }
      for (let j = 0; j < k; j += 1) {
        const label = coder.label(mode.member + Math.min(j, MEMBER_CLASSES - 1) * LABEL, count);
        if (j > 0 && label <= entries[at + j - 1]!) {
          throw fault("cluster-order", this.where, `cluster ${label} after ${entries[at + j - 1]} of row ${row} in mode ${n}`,
            "distinct clusters, ascending within a row");
        }
        entries[at + j] = label;
      }
    }
  }

  /** The parts of all rows in a mode, by labels. */
  private labels(n: number, first: number, rows: number, count: number, sameAt: number, labelAt: number): void {
    const { coder } = this;
    const part = this.arrays.level.part[n]!;
    let same = 0;
    for (let row = 0; row < rows; row += 1) {
      if (row > 0) {
        same = coder.bit(sameAt + same);
      }
      part[first + row] = same === 1 ? part[first + row - 1]! : coder.label(labelAt, count);
    }
  }

  /** The rows' parts in a mode of a node with cells. */
  private partsOfCells(s: number, n: number, count: number, { mixture, rows }: NodeShape): Parts {
    const { coder, arrays: { level } } = this;
    const mode = this.modes[n]!;
    const first = level.rowOffset[n]![s]!;
    if (count > 1) {
      const [k, entries, part] = [mixture[n]!, level.cluster[n]!, level.part[n]!];
      const from = level.clusterOffset[n]![s]!;
      if (coder.bit(mode.slots) === 0) {
        this.labels(n, first, rows[n]!, count, mode.samePart, mode.partLabel);
      } else {
        for (let row = 0; row < rows[n]!; row += 1) {
          part[first + row] = entries[from + row * k + (k > 1 ? coder.label(mode.slot, k) : 0)]!;
        }
      }
    }
    return this.parts(s, n, count);
  }

  private cut(s: number, rows: number[], extents: number[][]): void {
    const { coder, arrays } = this;
    const grids: (number[] | null)[] = [];
    const clusters: number[] = [];
    for (let n = 0; n < this.order; n += 1) {
      const mode = this.modes[n]!;
      const isGrid = coder.bit(mode.rule) === 0;
      const counts = (isGrid ? extents[n]! : [rows[n]!]).map((extent) => {
        const parts = 1 + coder.whole(mode.grid);
        if (isGrid && parts > extent) {
          throw fault("node-shape", this.where, `${parts} parts of ${extent} rows in mode ${n}`, "no more parts than rows");
        }
        return parts;
      });
      const most = arrays.stage.clusters[n]!;
      const count = counts.reduce((all, each) => Math.min(all * each, 2 * most + 1), 1);
      this.bounded("C", n, count, most);
      grids.push(isGrid ? counts : null);
      clusters.push(count);
    }
    if (product(clusters) < 2) {
      throw fault("node-shape", this.where, "a cut into one part", "two parts or more");
    }
    arrays.children!.check(product(clusters), this.where);
    this.setShape(s, 0, clusters);
    const none = rows.map(() => 0);
    arrays.take(0, 0, none, none);
    this.children(s, clusters.map((count, n) => {
      const grid = grids[n];
      if (grid != null) {
        return this.grid(s, n, extents[n]!, grid);
      }
      if (count > 1) {
        const { cutLabel, sameCut } = this.modes[n]!;
        this.labels(n, arrays.level.rowOffset[n]![s]!, rows[n]!, count, sameCut, cutLabel);
      }
      return this.parts(s, n, count);
    }));
  }

  /** The parts of a mode whose rows were given theirs. */
  private parts(s: number, n: number, count: number): Parts {
    const { nodes, level } = this.arrays;
    const [first, end] = [level.rowOffset[n]![s]!, level.rowOffset[n]![s + 1]!];
    const [part, local] = [level.part[n]!, level.local[n]!];
    const rows = new Uint32Array(count);
    for (let row = first; row < end; row += 1) {
      local[row] = rows[part[row]!]!;
      rows[part[row]!]! += 1;
    }
    return { rows, extents: new Uint32Array(count).fill(count > 1 ? 0 : nodes.extents[n]![s]!) };
  }

  /** The parts of a mode that is cut along each of its axes. */
  private grid(s: number, n: number, extents: number[], counts: number[]): Parts {
    const { level } = this.arrays;
    const part = level.part[n]!;
    const lengths = extents.map((extent, a) => segments(extent, counts[a]!));
    const first = level.rowOffset[n]![s]!;
    const rows = level.rowOffset[n]![s + 1]! - first;
    let stride = rows;
    extents.forEach((extent, a) => {
      stride /= extent;
      const of = segmentOf(lengths[a]!);
      for (let row = 0; row < rows; row += 1) {
        part[first + row] = part[first + row]! * counts[a]! + of[Math.floor(row / stride) % extent]!;
      }
    });
    const parts = this.parts(s, n, product(counts));
    return { rows: parts.rows, extents: Uint32Array.from(parts.rows, (_, p) => {
      const own = counts.map((_count, a) => {
        const after = product(counts.slice(a + 1));
        return lengths[a]![Math.floor(p / after) % counts[a]!]!;
      });
      return this.extents.number(own);
    }) };
  }

  private children(s: number, parts: Parts[]): void {
    this.arrays.children!.add(s, parts);
  }
}

function product(numbers: number[]): number {
  return numbers.reduce((all, each) => all * each, 1);
}

/** The lengths of so many parts of an extent. */
function segments(extent: number, count: number): number[] {
  return Array.from({ length: count }, (_, p) =>
    Math.floor((extent * (p + 1)) / count) - Math.floor((extent * p) / count));
}

/** Which part each index is of. */
function segmentOf(lengths: number[]): Uint16Array {
  return Uint16Array.from(lengths.flatMap((length, p) => new Array<number>(length).fill(p)));
}
