/** Random trees of nodes with all that the format has, and what a reader must make of them. */

import { halfValues } from "../src/reader/half";
import { type Node, productOf, sumOf } from "./encoder";

/** Whole numbers below `most`, the same in every run. */
export type Draw = (most: number) => number;

export function draws(seed: number): Draw {
  let state = seed;
  return (most) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * most);
  };
}

/** How a random stage is. */
export interface Wish {
  kind: "coded" | "half" | "cut";
  last: boolean;
  clusters?: number; // most
  ranks?: number;
  large?: boolean; // numbers of up to 24 bits
}

interface Place {
  rows: number[];
  extents: number[][];
}

export const list = <T>(length: number, make: (i: number) => T): T[] => Array.from({ length }, (_, i) => make(i));

/** A node at a place, and the places of its children. */
export function randomNode(draw: Draw, { rows, extents }: Place, wish: Wish): { node: Node; children: Place[] } {
  const order = rows.length;
  const node: Node = {
    kind: "empty", rows, extents, clusters: rows.map(() => 0), mixture: rows.map(() => 0), ranks: rows.map(() => 0),
    cluster: rows.map(() => []), part: rows.map(() => null), grid: rows.map(() => null), k: rows.map(() => []),
    core: [], basis: rows.map(() => []),
  };
  if (rows.includes(0) || draw(8) === 0) {
    return { node, children: [] };
  }
  if (!wish.last && (wish.kind === "cut" || draw(3) === 0)) {
    return { node, children: cut(draw, node, wish) };
  }
  if (wish.kind === "cut") {
    return { node, children: [] };
  }
  node.kind = "cells";
  for (let n = 0; n < order; n += 1) {
    if (draw(4) === 0) {
      [node.clusters[n], node.mixture[n], node.ranks[n]] = [1, 0, rows[n]!];
      continue;
    }
    const clusters = draw(2) === 0 ? 1 : 1 + draw(wish.clusters ?? 3);
    const mixture = 1 + draw(Math.min(clusters, 3));
    [node.clusters[n], node.mixture[n], node.ranks[n]] = [clusters, mixture, 1 + draw(wish.ranks ?? 3)];
    node.cluster[n] = list(rows[n]!, () => subset(draw, clusters, mixture));
    if (draw(3) === 0) { // neighbours in the same clusters
      node.cluster[n]!.forEach((_, i, all) => {
        all[i] = draw(3) === 0 || i === 0 ? all[i]! : all[i - 1]!;
      });
    }
  }
  numbers(draw, node, wish);
  return { node, children: !wish.last && draw(2) === 0 ? parts(draw, node) : [] };
}

function subset(draw: Draw, clusters: number, mixture: number): number[] {
  const left = list(clusters, (c) => c);
  return list(mixture, () => left.splice(draw(left.length), 1)[0]!).sort((a, b) => a - b);
}

function cut(draw: Draw, node: Node, wish: Wish): Place[] {
  do {
    node.rows.forEach((rows, n) => {
      const most = wish.clusters ?? 3;
      node.grid[n] = draw(2) === 0 ? null : node.extents[n]!.map((extent) => 1 + draw(Math.min(most, extent)));
      node.clusters[n] = node.grid[n] === null ? 1 + draw(most) : productOf(node.grid[n]!);
      const count = node.clusters[n]!;
      node.part[n] = list(rows, () => draw(count));
      const grid = node.grid[n];
      if (grid != null) {
        const extents = node.extents[n]!;
        node.part[n] = list(rows, (i) => extents.reduce((part, extent, a) => {
          const index = Math.floor(i / productOf(extents.slice(a + 1))) % extent;
          return part * grid[a]! + list(grid[a]!, (p) => p).find((p) => Math.floor((extent * (p + 1)) / grid[a]!) > index)!;
        }, 0));
      }
    });
  } while (productOf(node.clusters) < 2);
  node.kind = "cut";
  return places(node, (n, part) => {
    const grid = node.grid[n];
    if (grid == null) {
      return null;
    }
    return grid.map((count, a) => {
      const p = Math.floor(part / productOf(grid.slice(a + 1))) % count;
      const extent = node.extents[n]![a]!;
      return Math.floor((extent * (p + 1)) / count) - Math.floor((extent * p) / count);
    });
  });
}

/** Parts of cells: clusters, or anything. */
function parts(draw: Draw, node: Node): Place[] {
  node.clusters.forEach((count, n) => {
    const any = draw(2) === 0;
    node.part[n] = list(node.rows[n]!, (i) => {
      const own = node.cluster[n]![i] ?? [0];
      return count === 1 ? 0 : own.length > 1 && any ? draw(count) : own[draw(own.length)]!;
    });
  });
  return places(node, () => null);
}

/** The children's places; `extentsOf`: of a part of a mode, null where it has none but its rows. */
function places(node: Node, extentsOf: (n: number, part: number) => number[] | null): Place[] {
  return list(productOf(node.clusters), (child) => {
    const own = node.clusters.map((count, n) => Math.floor(child / productOf(node.clusters.slice(n + 1))) % count);
    const rows = own.map((part, n) => node.part[n]!.filter((each) => each === part).length);
    return { rows, extents: own.map((part, n) => extentsOf(n, part) ?? (node.clusters[n] === 1 ? node.extents[n]! : [rows[n]!])) };
  });
}

function numbers(draw: Draw, node: Node, { large = false }: Wish): void {
  const cells = productOf(node.clusters);
  const any = (): number => {
    const most = large && draw(6) === 0 ? 2 ** draw(25) : draw(9) === 0 ? 200 : 5;
    return (draw(2) === 0 ? 1 : -1) * (draw(3) === 0 ? 0 : Math.min(2 ** 24 - 1, draw(most)));
  };
  // Of a large number's column the step must be so fine that half precision holds it.
  node.k = node.mixture.map((k, n) => (k === 0 ? [] : list(cells, () => list(node.ranks[n]!, () => (large ? 20 : 0) + draw(12)))));
  node.core = list(cells * productOf(node.ranks), any);
  node.basis = node.mixture.map((k, n) => (k === 0 ? []
    : list(node.rows[n]! * k * (cells / node.clusters[n]!) * node.ranks[n]!, any)));
  for (let c = 0; c < cells; c += 1) { // cells without rows have no numbers
    const cell = node.clusters.map((count, n) => Math.floor(c / productOf(node.clusters.slice(n + 1))) % count);
    if (node.mixture.some((k, n) => k > 0 && !node.cluster[n]!.some((own) => own.includes(cell[n]!)))) {
      clear(node, c, cell);
    }
  }
}

function clear(node: Node, c: number, cell: number[]): void {
  const size = productOf(node.ranks);
  node.core.fill(0, c * size, (c + 1) * size);
  node.mixture.forEach((k, n) => {
    const others = cell.reduce((at, own, m) => (m === n ? at : at * node.clusters[m]! + own), 0);
    const count = productOf(node.clusters) / node.clusters[n]!;
    node.cluster[n]!.forEach((own, row) => own.forEach((cluster, j) => {
      if (k > 0 && cluster === cell[n]) {
        const at = ((row * k + j) * count + others) * node.ranks[n]!;
        node.basis[n]!.fill(0, at, at + node.ranks[n]!);
      }
    }));
    node.k[n]![c]?.fill(0);
  });
}

/** The stages of a random tree, nodes in order. */
export function randomTree(draw: Draw, axes: number[][], wishes: Wish[]): Node[][] {
  let level: Place[] = [{ rows: axes.map(productOf), extents: axes }];
  return wishes.map((wish) => {
    const made = level.map((place) => randomNode(draw, place, wish));
    level = made.flatMap(({ children }) => children);
    return made.map(({ node }) => node);
  });
}

/** The pattern of the float16 number nearest to one, of two as near the even one; that of infinity from 65520 on. */
export function nearest(value: number): number {
  const [values, size] = [halfValues(), Math.abs(value)];
  let [low, high] = [0, 0x7c00];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    [low, high] = values[middle]! <= size ? [middle, high] : [low, middle];
  }
  const above = low === 0x7bff ? 65536 : values[low + 1]!;
  const off = size - values[low]! - (above - size); // exact, as all are multiples of 2^-24, or large
  return (off > 0 || (off === 0 && low % 2 === 1) ? low + 1 : low) + (value < 0 ? 0x8000 : 0);
}

/** What a reader must have of the coded numbers of a node: core, scale, bases. */
export function widened(node: Node, step: number): { core: number[]; scale: number; basis: number[][] } {
  const largest = Math.max(0, ...node.core.map(Math.abs));
  let e = 0;
  while (largest > 2047 * 2 ** e) {
    e += 1;
  }
  const cells = productOf(node.clusters);
  const basis = node.basis.map((all, n) => all.map((q, at) => {
    const [rank, count] = [node.ranks[n]!, cells / node.clusters[n]!];
    const [entry, others] = [Math.floor(at / rank / count), Math.floor(at / rank) % count];
    const cluster = node.cluster[n]!.flat()[entry]!;
    const after = productOf(node.clusters.slice(n + 1));
    const cell = Math.floor(others / after) * after * node.clusters[n]! + cluster * after + (others % after);
    const k = node.k[n]![cell]![at % rank]!;
    const factor = k % 2 === 0 ? 2 ** (-k / 2) : Math.fround(0.70710678118654752) * 2 ** (-(k - 1) / 2);
    return nearest(Math.fround(q * factor));
  }));
  return { core: node.core.map((q) => nearest(q / 2 ** e)), scale: Math.fround(Math.fround(step) * 2 ** e), basis };
}

export const rowsOf = (nodes: Node[], n: number): number => sumOf(nodes.map(({ rows }) => rows[n]!));
