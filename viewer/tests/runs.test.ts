/** Random stages with all that the format has: a reader has of them what an encoder was given. */

import { describe, expect, it } from "vitest";
import type { PackedLevel } from "../src/reader/packed";
import { loads } from "../src/reader/read";
import type { Node } from "./encoder";
import { type StageContent, fileOf, randomContent } from "./files";
import { type Wish, draws, widened } from "./trees";

/** The arrays that a stage must have. */
function packedOf({ nodes, step, isHalf, stored }: StageContent, isLast: boolean): PackedLevel {
  const order = nodes[0]!.rows.length;
  const modes = Array.from({ length: order }, (_, n) => n);
  const offsets = (count: (node: Node) => number): Uint32Array => {
    const sums = [0];
    nodes.forEach((node) => sums.push(sums.at(-1)! + count(node)));
    return Uint32Array.from(sums);
  };
  const hasChildren = (node: Node): boolean => node.part[0] != null;
  const cells = (node: Node): number => (node.kind === "cells" ? node.clusters.reduce((all, each) => all * each, 1) : 0);
  const numbers = nodes.map((node, s) => {
    if (isHalf) {
      return stored![s]!;
    }
    const { core, scale, basis } = widened(node, step ?? 0);
    return { core, basis, scale: new Array<number>(cells(node)).fill(scale) };
  });
  const byRow = (n: number, of: (node: Node) => number[]): number[] => nodes.flatMap((node) =>
    (hasChildren(node) ? of(node) : new Array<number>(node.rows[n]!).fill(0)));
  return {
    order, nodes: nodes.length, step: step === null ? null : Math.fround(step),
    shape: Uint32Array.from(nodes.flatMap(({ clusters, mixture, ranks }) => [...clusters, ...mixture, ...ranks])),
    child: isLast ? null : offsets((node) => (hasChildren(node) ? node.clusters.reduce((all, each) => all * each, 1) : 0)),
    rowOffset: modes.map((n) => offsets(({ rows }) => rows[n]!)),
    core: Uint16Array.from(numbers.flatMap(({ core }) => core)), coreOffset: offsets(({ core }) => core.length),
    coreScale: Float32Array.from(numbers.flatMap(({ scale }) => scale)), cellOffset: offsets(cells),
    cluster: modes.map((n) => Uint16Array.from(nodes.flatMap(({ cluster }) => cluster[n]!.flat()))),
    clusterOffset: modes.map((n) => offsets(({ cluster }) => cluster[n]!.flat().length)),
    basis: modes.map((n) => Uint16Array.from(numbers.flatMap(({ basis }) => basis[n]!))),
    basisOffset: modes.map((n) => offsets(({ basis }) => basis[n]!.length)),
    part: modes.map((n) => (isLast ? null : Uint16Array.from(byRow(n, (node) => node.part[n]!)))),
    local: modes.map((n) => (isLast ? null : Uint32Array.from(byRow(n, (node) =>
      node.part[n]!.map((part, i, all) => all.slice(0, i).filter((each) => each === part).length))))),
  };
}

const coded: Wish = { kind: "coded", last: true };
const WISHES: [string, number[][], Wish[]][] = [
  ["one mode", [[17]], [coded]],
  ["several axes a mode", [[3, 5], [4], [2, 3, 2]], [{ ...coded, ranks: 4 }]],
  ["large numbers", [[6, 5], [7], [3]], [{ ...coded, large: true, clusters: 2 }]],
  ["half precision", [[6], [7, 2]], [{ kind: "half", last: false }, { kind: "half", last: true }]],
  ["cuts", [[8, 6], [9], [2]], [{ kind: "cut", last: false }, { kind: "cut", last: false }, coded]],
  ["levels and cuts", [[8, 6], [9], [2]], [{ ...coded, last: false }, { kind: "cut", last: false }, { ...coded, last: false }, coded]],
  ["many clusters", [[20], [15, 2]], [{ ...coded, last: false, clusters: 9, ranks: 2 }, { ...coded, clusters: 5 }]],
  ["more labels than a tree has", [[300]], [{ ...coded, clusters: 1000, ranks: 1 }]],
];

describe.each(WISHES)("%s", (_, axes, wishes) => {
  it.each([1, 2, 3, 4, 5, 6])("as it was coded: %i", (seed) => {
    const draw = draws(seed);
    let content = randomContent(draw, axes, wishes);
    while (content.stages.length < wishes.length) { // all nodes were leaves
      content = randomContent(draw, axes, wishes);
    }
    const found = loads(fileOf(content)).stages;
    expect(found).toHaveLength(wishes.length);
    content.stages.forEach((stage, t) => {
      const expected = packedOf(stage, t === wishes.length - 1);
      for (const [key, table] of Object.entries(expected)) {
        expect(found[t]![key as keyof PackedLevel], `${key} of stage ${t}`).toEqual(table);
      }
    });
  });
});
