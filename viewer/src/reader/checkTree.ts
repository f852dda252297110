/** Checks of the tree: children numbered in order, and every row of a node in one place of one child list. */

import { fault } from "./reasons";
import { type Geometry, type Nodes, nameIn, offsetSteps } from "./tables";

/** Check `child`, `part` and `local` of a level against the nodes of the next one. */
export function checkParts(above: Geometry, below: Geometry): void {
  const counts = checkChildren(above, above.packed.child ?? new Uint32Array(1), below.nodes);
  const slots = above.clusters.map((clusters) => slotStarts(clusters, counts));
  for (let n = 0; n < above.packed.order; n += 1) {
    const [parts, locals] = [above.packed.part[n] ?? null, above.packed.local[n] ?? null];
    const owned = parts === null || locals === null ? null : checkMode(above, n, counts, slots[n]!, parts, locals);
    checkChildRows(above, below, n, counts, slots[n]!, owned);
  }
}

/** The number of children of each node: none or PC, which together are the `nodes` of the next level. */
export function checkChildren(above: Nodes, child: Uint32Array, nodes: number): Float64Array {
  const name = nameIn(above, "child");
  const counts = offsetSteps(child, name);
  counts.forEach((count, s) => {
    if (count !== 0 && count !== above.cells[s]) {
      throw fault("child-order", name, `${count} children of node ${s}`,
        `0 or ${above.cells[s]}, one for each combination of parts`);
    }
  });
  const last = child[child.length - 1] ?? 0;
  if (last !== nodes) {
    throw fault("child-order", name, `${last} children`, `${nodes}, the nodes of the next level`);
  }
  return counts;
}

/** First slot of each node in a table with a slot for each part of a mode of each node that has children. */
export function slotStarts(clusters: Uint32Array, counts: Float64Array): Float64Array {
  const starts = new Float64Array(counts.length + 1);
  counts.forEach((count, s) => {
    starts[s + 1] = starts[s]! + (count > 0 ? clusters[s]! : 0);
  });
  return starts;
}

/** Calls `visit` with each row of a mode, the node that owns it, and its position there. */
export function eachRow(rows: Float64Array, visit: (row: number, node: number, position: number) => void): void {
  let row = 0;
  for (let s = 0; s < rows.length; s += 1) {
    for (let position = 0; position < rows[s]!; position += 1, row += 1) {
      visit(row, s, position);
    }
  }
}

/** Check the rows of one mode; return how many rows each slot gets. */
function checkMode(
  above: Geometry, n: number, counts: Float64Array, slots: Float64Array, part: Uint16Array, local: Uint32Array,
): Float64Array {
  const rows = above.rows[n]!;
  const total = rows.reduce((all, each) => all + each, 0);
  const [partName, localName] = [nameIn(above, `part/${n}`), nameIn(above, `local/${n}`)];
  for (const [name, array] of [[partName, part], [localName, local]] as const) {
    if (array.length !== total) {
      throw fault("array-shape", name, `[${array.length}]`, `[${total}]`);
    }
  }
  for (const [name, array] of [[partName, part], [localName, local]] as const) {
    eachRow(rows, (row, s) => {
      if (counts[s] === 0 && array[row] !== 0) {
        throw fault("leaf-rows", name, `${array[row]} in row ${row}`, "0 in a leaf's rows");
      }
    });
  }
  const owned = rowsOwned(above, n, counts, slots, part);
  checkPlaces(above, n, counts, slots, owned, part, local);
  eachRow(rows, (row, s, position) => {
    if (counts[s]! > 0 && above.cells[s] === 1 && local[row] !== position) {
      throw fault("self-child", localName, `${local[row]} in row ${row}`,
        `${position}, as an only child keeps all rows in order`);
    }
  });
  return owned;
}

/** How many rows of a mode each slot gets; their parts must be those of their nodes. */
export function rowsOwned(
  above: Nodes, n: number, counts: Float64Array, slots: Float64Array, part: Uint16Array,
): Float64Array {
  const clusters = above.clusters[n]!;
  const owned = new Float64Array(slots[slots.length - 1]!);
  eachRow(above.rows[n]!, (row, s) => {
    if (counts[s] === 0) {
      return;
    }
    if (part[row]! >= clusters[s]!) {
      throw fault("part-range", nameIn(above, `part/${n}`), `${part[row]} in row ${row}`, `less than ${clusters[s]}`);
    }
    owned[slots[s]! + part[row]!]! += 1;
  });
  return owned;
}

/** The local positions of the rows of each slot must be 0, 1, .. up to their number, each once. */
function checkPlaces(
  above: Geometry, n: number, counts: Float64Array, slots: Float64Array, owned: Float64Array,
  part: Uint16Array, local: Uint32Array,
): void {
  const name = nameIn(above, `local/${n}`);
  const firstPlace = new Float64Array(owned.length + 1);
  owned.forEach((count, slot) => {
    firstPlace[slot + 1] = firstPlace[slot]! + count;
  });
  const taken = new Uint8Array(firstPlace[owned.length]!);
  eachRow(above.rows[n]!, (row, s) => {
    if (counts[s]! > 0 && local[row]! >= owned[slots[s]! + part[row]!]!) {
      throw fault("local-range", name, `${local[row]} in row ${row}`, `less than ${owned[slots[s]! + part[row]!]}`);
    }
  });
  eachRow(above.rows[n]!, (row, s) => {
    if (counts[s] === 0) {
      return;
    }
    const place = firstPlace[slots[s]! + part[row]!]! + local[row]!;
    if (taken[place] !== 0) {
      throw fault("local-twice", name, `${local[row]} in row ${row} and in another row of its part`,
        "each position once");
    }
    taken[place] = 1;
  });
}

/** Every child owns the rows that its parent's parts give it; of an undecomposed mode (`owned` null), all of them. */
function checkChildRows(
  above: Geometry, below: Geometry, n: number, counts: Float64Array, slots: Float64Array, owned: Float64Array | null,
): void {
  rowsOfChildren(above, n, counts, slots, owned).forEach((expected, child) => {
    if (below.rows[n]![child] !== expected) {
      throw fault("row-count", nameIn(below, `row_offset/${n}`), `${below.rows[n]![child]} rows of node ${child}`,
        `${expected}, those that its parent's parts give it`);
    }
  });
}

/** How many rows of a mode each node of the next level owns: those of its slot, or all of an undecomposed mode. */
export function rowsOfChildren(
  above: Nodes, n: number, counts: Float64Array, slots: Float64Array, owned: Float64Array | null,
): Float64Array {
  const rows = new Float64Array(counts.reduce((all, each) => all + each, 0));
  let child = 0;
  for (let s = 0; s < counts.length; s += 1) {
    let stride = 1; // parts are flattened in C order, the last mode fastest
    for (let m = n + 1; m < above.clusters.length; m += 1) {
      stride *= above.clusters[m]![s]!;
    }
    for (let number = 0; number < counts[s]!; number += 1, child += 1) {
      const slot = slots[s]! + (Math.floor(number / stride) % above.clusters[n]![s]!);
      rows[child] = owned === null ? above.rows[n]![s]! : owned[slot]!;
    }
  }
  return rows;
}
