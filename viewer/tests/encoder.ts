/** An encoder of runs, by the text of `docs/format.md` alone: models by names, no thought of speed. */

/** A node as it is coded. Lists are by mode; `null` stands for what the node does not have. */
export interface Node {
  kind: "empty" | "cells" | "cut";
  rows: number[];
  extents: number[][];
  clusters: number[];
  mixture: number[];
  ranks: number[];
  cluster: number[][][]; // of each row, K of them
  part: (number[] | null)[]; // of each row, where there are children
  grid: (number[] | null)[];
  k: number[][][]; // of each cell, R of them
  core: number[]; // [PC, R_1, .., R_N]
  basis: number[][]; // [m, K, PC_-n, R]
}

export const sumOf = (numbers: number[]): number => numbers.reduce((all, each) => all + each, 0);
export const productOf = (numbers: number[]): number => numbers.reduce((all, each) => all * each, 1);
const bitLength = (number: number): number => (number === 0 ? 0 : Math.floor(Math.log2(number)) + 1);

/** Writes bits, each by a model that is named. */
export class Encoder {
  private low = 0;
  private range = 2 ** 32 - 1;
  private held = 0;
  private waiting = 0;
  private readonly bytes: number[] = [];
  private readonly models = new Map<string, { p: number; n: number }>();

  bit(name: string, bit: boolean): void {
    const model = this.models.get(name) ?? { p: 32768, n: 0 };
    this.models.set(name, model);
    const bound = Math.floor(this.range / 65536) * model.p;
    const rate = Math.floor(65536 / (model.n + 2));
    if (bit) {
      this.low += bound;
      this.range -= bound;
      model.p -= Math.floor((model.p * rate) / 65536);
    } else {
      this.range = bound;
      model.p += Math.floor(((65536 - model.p) * rate) / 65536);
    }
    model.p = Math.min(65504, Math.max(32, model.p));
    model.n = Math.min(model.n + 1, 254);
    this.normalise();
  }

  raw(bits: number, value: number): void {
    for (let at = bits - 1; at >= 0; at -= 1) {
      this.range = Math.floor(this.range / 2);
      this.low += Math.floor(value / 2 ** at) % 2 === 1 ? this.range : 0;
      this.normalise();
    }
  }

  whole(name: string, value: number): void {
    const b = bitLength(value + 1) - 1;
    for (let i = 0; i <= b; i += 1) {
      this.bit(`${name}.prefix${i}`, i < b);
    }
    const digits = (value + 1).toString(2).slice(1);
    if (b >= 1) {
      this.bit(`${name}.first${b}`, digits[0] === "1");
    }
    if (b >= 2) {
      this.bit(`${name}.second${b},${digits[0]}`, digits[1] === "1");
      this.raw(b - 2, (value + 1) % 2 ** (b - 2));
    }
  }

  label(name: string, value: number, count: number): void {
    const digits = value.toString(2).padStart(bitLength(count - 1), "0");
    [...digits.slice(0, 8)].forEach((digit, i) => this.bit(`${name}.tree1${digits.slice(0, i)}`, digit === "1"));
    this.raw(Math.max(0, digits.length - 8), value % 2 ** Math.max(0, digits.length - 8));
  }

  magnitude(name: string, context: number, shift: number, value: number): void {
    const high = Math.floor(value / 2 ** shift);
    for (let i = 0; i < Math.min(14, high + 1); i += 1) {
      this.bit(`${name}.${context}.${i}`, i < high);
    }
    if (high >= 14) {
      const bits = bitLength(high - 14);
      for (let i = 0; i <= bits; i += 1) {
        this.bit(`${name}.escape${i}`, i < bits);
      }
      this.raw(Math.max(0, bits - 1), (high - 14) % 2 ** Math.max(0, bits - 1));
    }
    this.raw(shift, value % 2 ** shift);
  }

  finish(): Uint8Array {
    for (let i = 0; i < 5; i += 1) {
      this.shift();
    }
    return Uint8Array.from(this.bytes.slice(1));
  }

  private normalise(): void {
    while (this.range < 2 ** 24) {
      this.range *= 256;
      this.shift();
    }
  }

  private shift(): void {
    if (this.low % 2 ** 32 < 0xff000000 || this.low >= 2 ** 32) {
      const carry = Math.floor(this.low / 2 ** 32);
      this.bytes.push((this.held + carry) % 256, ...new Array<number>(this.waiting).fill((255 + carry) % 256));
      this.waiting = 0;
      this.held = Math.floor(this.low / 2 ** 24) % 256;
    } else {
      this.waiting += 1;
    }
    this.low = (this.low % 2 ** 24) * 256;
  }
}

/** The code of a run. `isLast`: of the last stage; `coded`: whether its numbers are in the code. */
export function encodeRun(nodes: Node[], isLast: boolean, coded: boolean): Uint8Array {
  const to = new Encoder();
  let kind = 0;
  let parted = false;
  const undecomposed: number[] = [];
  const rank: number[] = [];
  for (const node of nodes) {
    if (node.rows.includes(0)) {
      continue;
    }
    to.bit(`kind${kind}.a`, node.kind === "cells");
    if (node.kind !== "cells" && !isLast) {
      to.bit(`kind${kind}.b`, node.kind === "cut");
    }
    kind = ["empty", "cells", "cut"].indexOf(node.kind);
    if (node.kind === "cut") {
      encodeCut(to, node);
    } else if (node.kind === "cells") {
      const parts = node.part[0] != null;
      if (!isLast) {
        to.bit(`parted${parted}`, parts);
        parted = parts;
      }
      node.mixture.forEach((k, n) => {
        to.bit(`undecomposed${n},${undecomposed[n] ?? 0}`, k === 0);
        undecomposed[n] = k === 0 ? 1 : 0;
        if (k > 0) {
          to.whole(`C${n}`, node.clusters[n]! - 1);
          if (node.clusters[n]! > 1) {
            to.whole(`K${n}`, k - 1);
          }
          to.whole(`R${n},${rank[n] ?? 0}`, node.ranks[n]! - 1);
          rank[n] = Math.min(12, bitLength(node.ranks[n]!));
        }
      });
      encodeTables(to, node, parts);
      if (coded) {
        new Numbers(to, node).encode();
      }
    }
  }
  return to.finish();
}

function encodeCut(to: Encoder, node: Node): void {
  node.grid.forEach((grid, n) => {
    to.bit(`rule${n}`, grid === null);
    (grid ?? [node.clusters[n]!]).forEach((count) => to.whole(`G${n}`, count - 1));
  });
  node.grid.forEach((grid, n) => {
    if (grid === null && node.clusters[n]! > 1) {
      encodeLabels(to, `cut${n}`, node.part[n]!.map((part) => [part]), node.clusters[n]!);
    }
  });
}

function encodeLabels(to: Encoder, name: string, labels: number[][], count: number): void {
  let before = false;
  labels.forEach((own, i) => {
    const same = i > 0 && own.join() === labels[i - 1]!.join();
    if (i > 0) {
      to.bit(`same${name},${before}`, same);
    }
    before = same;
    if (!same) {
      own.forEach((label, j) => to.label(`label${name},${Math.min(j, 7)}`, label, count));
    }
  });
}

function encodeTables(to: Encoder, node: Node, parts: boolean): void {
  node.clusters.forEach((count, n) => {
    if (count > 1) {
      encodeLabels(to, `member${n}`, node.cluster[n]!, count);
    }
  });
  node.clusters.forEach((count, n) => {
    if (parts && count > 1 && node.mixture[n]! > 0) {
      const slots = node.part[n]!.map((part, i) => node.cluster[n]![i]!.indexOf(part));
      to.bit(`slots${n}`, !slots.includes(-1));
      if (slots.includes(-1)) {
        encodeLabels(to, `part${n}`, node.part[n]!.map((part) => [part]), count);
      } else {
        slots.filter(() => node.mixture[n]! > 1).forEach((slot) => to.label(`slot${n}`, slot, node.mixture[n]!));
      }
    }
  });
}

const NEIGHBOUR = [0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 5, 6];
const clamp = (number: number, low: number, high: number): number => Math.min(high, Math.max(low, number));
const shiftOf = (t: number): number => clamp(Math.floor(t / 2) - 3, 0, 20);

/** The numbers of a node. */
class Numbers {
  private readonly decomposed: number[];

  constructor(private readonly to: Encoder, private readonly node: Node) {
    this.decomposed = node.mixture.flatMap((k, n) => (k > 0 ? [n] : []));
  }

  encode(): void {
    const { clusters } = this.node;
    for (let c = 0; c < productOf(clusters); c += 1) {
      const cell = clusters.map((count, n) => Math.floor(c / productOf(clusters.slice(n + 1))) % count);
      const members = this.node.cluster.map((rows, n) => rows.flatMap((own, i) => (own.includes(cell[n]!) ? [i] : [])));
      if (this.decomposed.every((n) => members[n]!.length > 0)) {
        this.cell(c, cell, members);
      }
    }
  }

  private cell(c: number, cell: number[], members: number[][]): void {
    const { node, to } = this;
    let before = -1;
    for (const n of this.decomposed) {
      node.k[n]![c]!.forEach((k, r) => {
        if (before < 0) {
          to.whole("Kf", k);
        } else {
          const less = (r === 0 ? node.k[this.decomposed[0]!]![c]![0]! : before) - k;
          to.whole(`Kd${n},${r > 0}`, less >= 0 ? 2 * less : -2 * less - 1);
        }
        before = k;
      });
      node.k[n]![c]!.forEach((k, r) => this.column(n, r, k, cell, members[n]!));
    }
    this.core(c);
  }

  private column(n: number, r: number, k: number, cell: number[], members: number[]): void {
    const { node, to } = this;
    const [clusters, rank] = [node.clusters[n]!, node.ranks[n]!];
    const others = node.clusters.map((_, m) => m).filter((m) => m !== n);
    const flat = others.reduce((at, m) => at * node.clusters[m]! + cell[m]!, 0);
    const values = members.map((row) => {
      const entry = row * node.mixture[n]! + node.cluster[n]![row]!.indexOf(cell[n]!);
      return node.basis[n]![(entry * productOf(others.map((m) => node.clusters[m]!)) + flat) * rank + r]!;
    });
    const t = k - Math.round(2 * Math.log2(members.length));
    const [shift, size] = [shiftOf(t), clamp(t + 16, 0, 79)];
    const extents = node.extents[n]!;
    const last = extents.at(-1)!;
    const grid = clusters === 1 && extents.length > 1;
    values.forEach((value, i) => {
      const a = grid && i % last === 0 ? undefined : values[i - 1];
      const b = values[i - (grid ? last : 2)];
      const sum = Math.abs(a ?? b ?? 0) + Math.abs(b ?? a ?? 0);
      to.magnitude("basis", size * 7 + NEIGHBOUR[Math.min(11, Math.floor(sum / 2 ** shift))]!, shift, Math.abs(value));
      if (value !== 0) {
        to.bit(`basissign${3 * Math.sign(a ?? 0) + Math.sign(b ?? 0)},${Math.min(size, 63) >> 2}`, value < 0);
      }
    });
  }

  private core(c: number): void {
    const { node, to, decomposed } = this;
    const axes = node.ranks.flatMap((rank, n) => (node.mixture[n]! > 0 ? [{ n, size: rank }] : node.extents[n]!.map((size) => ({ n, size }))));
    const strides = axes.map((_, a) => productOf(axes.slice(a + 1).map(({ size }) => size)));
    const order = node.ranks.flatMap((_, n) => axes.flatMap((axis, a) => (axis.n === n ? [a] : [])).reverse());
    const whole = node.ranks.flatMap((_, n) => (node.mixture[n] === 0 ? [n] : []));
    let base = 0;
    if (decomposed.length > 0) {
      const energy = Math.floor(Math.log2(1.4142135623730951 * sumOf(node.k[decomposed[0]!]![c]!.map((k) => 2 ** k))));
      base = -(decomposed.length - 1) * energy - sumOf(whole.map((n) => bitLength(node.rows[n]!) - 1));
    }
    const core = node.core.slice(c * productOf(node.ranks), (c + 1) * productOf(node.ranks));
    core.forEach((value, i) => {
      const index = axes.map(({ size }, a) => Math.floor(i / strides[a]!) % size);
      const t = base + sumOf(axes.map(({ n }, a) => (node.mixture[n]! > 0 ? node.k[n]![c]![index[a]!]! : 0)));
      const shift = shiftOf(t);
      const near = order.filter((a) => index[a]! > 0);
      const sum = sumOf(near.map((a) => Math.abs(core[i - strides[a]!]!)));
      const context = clamp(t + 40, 0, 95) * 7 + NEIGHBOUR[Math.min(11, Math.floor(sum / 2 ** shift))]!;
      to.magnitude("core", context, shift, Math.abs(value));
      if (value !== 0 && whole.length > 0) {
        const [a = 0, b = 0] = near.filter((axis) => node.mixture[axes[axis]!.n] === 0).map((axis) => Math.sign(core[i - strides[axis]!]!));
        to.bit(`coresign${3 * a + b}`, value < 0);
      } else if (value !== 0) {
        to.raw(1, value < 0 ? 1 : 0);
      }
    });
  }
}
