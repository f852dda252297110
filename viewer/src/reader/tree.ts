/** The rows of a stage's nodes: how many each has, and in what axes they lie; and those of its nodes' children. */

import { fault } from "./reasons";

/** What is known of the nodes of a stage before its runs are read. By mode. */
export interface Nodes {
  rows: Uint32Array[]; // of each node
  extents: Uint32Array[]; // of each node: which of the tree's extents its rows have
}

/** All extents that nodes of a tree have in any mode, once each. Number 0: that of rows in no axes, as many as there are. */
export class Extents {
  private readonly all: number[][] = [[]];
  private readonly numbers = new Map<string, number>();

  /** The extents of rows, the last one fastest. */
  of(number: number, rows: number): number[] {
    return number === 0 ? [rows] : this.all[number]!;
  }

  number(extents: number[]): number {
    if (extents.length === 1) {
      return 0;
    }
    const key = extents.join();
    let found = this.numbers.get(key);
    if (found === undefined) {
      found = this.all.push(extents) - 1;
      this.numbers.set(key, found);
    }
    return found;
  }
}

/** The root's rows are those of all modes. */
export function rootOf(sizes: number[][], extents: Extents): Nodes {
  return {
    rows: sizes.map((mode) => Uint32Array.of(mode.reduce((rows, size) => rows * size, 1))),
    extents: sizes.map((mode) => Uint32Array.of(extents.number(mode))),
  };
}

/** A node's parts of one mode: how many rows each has, and which extents. */
export interface Parts {
  rows: Uint32Array;
  extents: Uint32Array;
}

/** The nodes of the next stage, in the order in which their parents are read. */
export class Children {
  readonly child: Uint32Array;
  readonly nodes: Nodes;
  private made = 0;

  constructor(parents: number, private readonly count: number, order: number, private readonly where: string) {
    const table = (): Uint32Array[] => Array.from({ length: order }, () => new Uint32Array(count));
    this.child = new Uint32Array(parents + 1);
    this.nodes = { rows: table(), extents: table() };
  }

  /** Refuse more than there is room for. */
  check(children: number, where: string): void {
    if (this.made + children > this.count) {
      throw fault("run-count", where, `${this.made + children} children and more`, `${this.count}, the nodes of the next stage`);
    }
  }

  /** Add the children of node s, for all combinations of the parts of each mode; `check` has found that there is room. */
  add(s: number, parts: Parts[]): void {
    const count = parts.reduce((all, { rows }) => all * rows.length, 1);
    let stride = count;
    parts.forEach(({ rows, extents }, n) => {
      stride /= rows.length;
      for (let i = 0; i < count; i += 1) {
        const part = Math.floor(i / stride) % rows.length;
        this.nodes.rows[n]![this.made + i] = rows[part]!;
        this.nodes.extents[n]![this.made + i] = extents[part]!;
      }
    });
    this.made += count;
    this.child[s + 1] = this.made;
  }

  /** Node s has none. */
  none(s: number): void {
    this.child[s + 1] = this.made;
  }

  /** Check that all nodes of the next stage are there, with as many rows in each mode as the header says. */
  finish(rows: number[]): Nodes {
    if (this.made !== this.count) {
      throw fault("child-count", this.where, `${this.made} children`, `${this.count}, the nodes of the next stage`);
    }
    rows.forEach((stated, n) => {
      const found = this.nodes.rows[n]!.reduce((sum, each) => sum + each, 0);
      if (found !== stated) {
        throw fault("row-count", this.where, `${found} rows of children in mode ${n}`, `${stated}, those of the next stage`);
      }
    });
    return this.nodes;
  }
}
