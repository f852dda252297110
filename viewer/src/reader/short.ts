/** Short tables (`docs/format.md`, section 3): what files of versions 1.2 and 1.4 leave out, made again of the rest. */

import { checkChildren, eachRow, rowsOfChildren, rowsOwned, slotStarts } from "./checkTree";
import type { Metadata } from "./metadata";
import { fault } from "./reasons";
import { checkPacked } from "./rice";
import type { Find, TypedArray } from "./schema";
import { type Nodes, nameIn, nodesOf } from "./tables";

const MAX_U32 = 2 ** 32 - 1;

/**
 * The arrays, which `checkSchema` has let through, and all that is left out, in the types of memory.
 *
 * Nothing is made that is larger than what the file holds allows; core and basis numbers need not be `there` yet.
 */
export function completed(array: Find, metadata: Metadata, there: boolean): Find {
  const made = new Map<string, TypedArray>();
  let rows: Float64Array[] = metadata.modeSizes.map((size) => Float64Array.of(size));
  for (let level = 1; level <= metadata.levels.length; level += 1) {
    const shape = Uint32Array.from(array(`level/${level}/shape`)!);
    made.set(`level/${level}/shape`, shape);
    if (level === 1 && shape.length !== 3 * rows.length) {
      throw fault("array-shape", "level/1/shape", `${shape.length / (3 * rows.length)} nodes`, "one node at level 1");
    }
    const nodes = nodesOf(shape, rows, level, metadata.undecomposed);
    const own = new Completion(nodes, array, made);
    own.completeRagged(there);
    const below = array(`level/${level + 1}/shape`);
    rows = below === null ? rows : own.completeTree(below.length / (3 * rows.length));
  }
  return (name) => made.get(name) ?? array(name);
}

/** The arrays of one level. */
class Completion {
  constructor(
    private readonly nodes: Nodes, private readonly array: Find, private readonly made: Map<string, TypedArray>,
  ) {}

  private set(name: string, array: TypedArray): void {
    this.made.set(nameIn(this.nodes, name), array);
  }

  private largest(column: Uint32Array): number {
    return column.reduce((most, each) => Math.max(most, each), 0);
  }

  /** Offsets, by what the shapes of nodes need, and clusters where each mode has one. */
  completeRagged(there: boolean): void {
    const { rows, mixture, cells, decomposed } = this.nodes;
    const numbers = this.numbers();
    const packed = this.array(nameIn(this.nodes, "core")) instanceof Uint8Array;
    if (packed) {
      checkPacked(this.nodes, this.array, numbers, there);
    }
    const ownNumbers = (offsets: string, array: string): void => {
      const needed = numbers.get(array)!;
      if (packed) {
        this.set(offsets, this.sums(array, needed));
      } else {
        this.own(offsets, array, needed);
      }
    };
    ownNumbers("core_offset", "core");
    this.own("cell_offset", "core_scale", (s) => cells[s]!);
    for (const n of decomposed) {
      const entries = (s: number): number => rows[n]![s]! * mixture[n]![s]!;
      ownNumbers(`basis_offset/${n}`, `basis/${n}`);
      this.set(`cluster/${n}`, this.clusters(n, entries));
      this.own(`cluster_offset/${n}`, `cluster/${n}`, entries);
    }
    rows.forEach((own, n) => this.set(`row_offset/${n}`, this.sums("shape", (s) => own[s]!)));
  }

  /** How many core and basis numbers a node has, by the names of their arrays. */
  private numbers(): Map<string, (s: number) => number> {
    const { clusters, mixture, ranks, rows, cells, decomposed } = this.nodes;
    const numbers = new Map([["core", (s: number): number => ranks.reduce((all, rank) => all * rank[s]!, cells[s]!)]]);
    for (const n of decomposed) {
      const others = (s: number): number => clusters.reduce((all, each, m) => (m === n ? all : all * each[s]!), 1);
      numbers.set(`basis/${n}`, (s) => rows[n]![s]! * mixture[n]![s]! * others(s) * ranks[n]![s]!);
    }
    return numbers;
  }

  /** Bases have as many entries at the least, so that clusters which are left out are bounded by what the file holds. */
  private clusters(n: number, entries: (s: number) => number): Uint16Array {
    const name = nameIn(this.nodes, `cluster/${n}`);
    const stored = this.array(name);
    if (stored !== null) {
      return Uint16Array.from(stored);
    }
    if (this.largest(this.nodes.clusters[n]!) > 1) {
      throw fault("array-missing", name, "no such array", "an array, as nodes have clusters");
    }
    return new Uint16Array(Array.from(this.nodes.rows[n]!, (_, s) => entries(s)).reduce((all, each) => all + each, 0));
  }

  private own(offsets: string, array: string, needed: (s: number) => number): void {
    const name = nameIn(this.nodes, array);
    const found = (this.made.get(name) ?? this.array(name))!.length;
    const sums = this.sums(array, needed);
    if (found !== sums[sums.length - 1]) {
      throw fault("array-shape", name, `[${found}]`, `[${sums[sums.length - 1]}]`);
    }
    this.set(offsets, sums);
  }

  private sums(array: string, needed: (s: number) => number): Uint32Array {
    const sums = new Float64Array(this.nodes.nodes + 1);
    for (let s = 0; s < this.nodes.nodes; s += 1) {
      sums[s + 1] = sums[s]! + needed(s);
    }
    if (sums[this.nodes.nodes]! > MAX_U32) {
      throw fault("array-shape", nameIn(this.nodes, array), `${sums[this.nodes.nodes]} entries`, `at most ${MAX_U32}`);
    }
    return Uint32Array.from(sums);
  }

  /** Parts and positions of rows; how many rows each of the next level's nodes owns, by mode. */
  completeTree(nodesBelow: number): Float64Array[] {
    const child = Uint32Array.from(this.array(nameIn(this.nodes, "child"))!);
    this.set("child", child);
    const counts = checkChildren(this.nodes, child, nodesBelow);
    return this.nodes.rows.map((_, n) => {
      const slots = slotStarts(this.nodes.clusters[n]!, counts);
      const owned = this.nodes.decomposed.includes(n) ? this.completeMode(n, counts, slots) : null;
      return rowsOfChildren(this.nodes, n, counts, slots, owned);
    });
  }

  private completeMode(n: number, counts: Float64Array, slots: Float64Array): Float64Array {
    const total = this.nodes.rows[n]!.reduce((all, each) => all + each, 0);
    const part = this.parts(n, counts, total);
    if (part.length !== total) {
      throw fault("array-shape", nameIn(this.nodes, `part/${n}`), `[${part.length}]`, `[${total}]`);
    }
    this.set(`part/${n}`, part);
    const owned = rowsOwned(this.nodes, n, counts, slots, part);
    const local = this.array(nameIn(this.nodes, `local/${n}`));
    this.set(`local/${n}`, local === null ? this.places(n, counts, slots, part) : Uint32Array.from(local));
    return owned;
  }

  /** Where it is left out, the part of a row is its only cluster. */
  private parts(n: number, counts: Float64Array, total: number): Uint16Array {
    const name = nameIn(this.nodes, `part/${n}`);
    const stored = this.array(name);
    if (stored !== null) {
      return Uint16Array.from(stored);
    }
    const mixture = this.nodes.mixture[n]!;
    if (this.largest(mixture) !== 1) {
      throw fault("array-missing", name, "no such array", "an array, as clusters do not tell parts");
    }
    const cluster = this.made.get(nameIn(this.nodes, `cluster/${n}`))!;
    const part = new Uint16Array(total);
    let at = 0;
    eachRow(this.nodes.rows[n]!, (row, s) => {
      part[row] = counts[s]! > 0 ? cluster[at]! : 0;
      at += mixture[s]!;
    });
    return part;
  }

  /** Where they are left out, positions are those among the rows of a part, in their order. */
  private places(n: number, counts: Float64Array, slots: Float64Array, part: Uint16Array): Uint32Array {
    const next = new Uint32Array(slots[slots.length - 1]!);
    const local = new Uint32Array(part.length);
    eachRow(this.nodes.rows[n]!, (row, s) => {
      if (counts[s]! > 0) {
        const slot = slots[s]! + part[row]!;
        local[row] = next[slot]!;
        next[slot]! += 1;
      }
    });
    return local;
  }
}
