/** Files of version 1, made of trees of nodes. */

import { crc32 } from "node:zlib";
import { type Node, encodeRun, productOf, sumOf } from "./encoder";
import { type Draw, type Wish, list, randomTree, rowsOf } from "./trees";

export interface StageContent {
  nodes: Node[];
  runs: number[]; // how many nodes each has
  step: number | null; // null, with `isHalf` false: a cut stage
  isHalf: boolean;
  stored?: { core: number[]; basis: number[][]; scale: number[] }[]; // of each node, patterns and scales
}

export interface Content {
  header: Record<string, unknown>; // but for the stages
  coordinates: Uint8Array[];
  stages: StageContent[];
}

/** Bytes of a section: its payload and checksum. */
export function section(payload: Uint8Array): Buffer {
  const sum = Buffer.alloc(4);
  sum.writeUInt32LE(crc32(payload));
  return Buffer.concat([payload, sum]);
}

/** A file of a header's text and sections. */
export function assemble(text: string | Uint8Array, sections: Uint8Array[], version = 1): Uint8Array<ArrayBuffer> {
  const header = Buffer.from(text);
  const prefix = Buffer.alloc(20);
  prefix.write("\x89HMK\r\n\x1a\n", "latin1");
  [version, header.length, crc32(header)].forEach((word, i) => prefix.writeUInt32LE(word, 8 + 4 * i));
  return new Uint8Array(Buffer.concat([prefix, header, ...sections.map(section)]));
}

/** The payloads of a stage's runs, and what the header says of the stage. */
export function encodeStage({ nodes, runs, step, isHalf, stored }: StageContent, isLast: boolean): { header: Record<string, unknown>; payloads: Uint8Array[] } {
  const order = nodes[0]!.rows.length;
  const payloads: Uint8Array[] = [];
  const counts: number[][] = [];
  let first = 0;
  for (const count of runs) {
    const own = nodes.slice(first, first + count);
    const numbers = stored?.slice(first, first + count) ?? [];
    first += count;
    const code = encodeRun(own, isLast, step !== null);
    const halves = [...numbers.flatMap(({ core }) => core), ...list(order, (n) => numbers.flatMap(({ basis }) => basis[n]!)).flat()];
    const raw = [new Uint8Array(Uint16Array.from(halves).buffer), new Uint8Array(Float32Array.from(numbers.flatMap(({ scale }) => scale)).buffer)];
    payloads.push(new Uint8Array(Buffer.concat([code, ...raw])));
    const cells = own.map(({ kind, clusters }) => (kind === "cells" ? productOf(clusters) : 0));
    counts.push([count, code.length, sumOf(cells), sumOf(own.map(({ core }) => core.length)),
      ...list(order, (n) => sumOf(own.map(({ basis }) => basis[n]!.length)))]);
  }
  const largest = (["clusters", "mixture", "ranks"] as const).map((key) => list(order, (n) => Math.max(0, ...nodes.map((node) => node[key][n]!))));
  return {
    payloads,
    header: {
      nodes: nodes.length, ...(step === null ? {} : { step }), ...(isHalf ? { bits: 16 } : {}), largest,
      rows: list(order, (n) => rowsOf(nodes, n)), runs: counts,
    },
  };
}

/** The header's text and the sections of a file. */
export function encode({ header, coordinates, stages }: Content): { header: Record<string, unknown>; sections: Uint8Array[] } {
  const made = stages.map((stage, t) => encodeStage(stage, t === stages.length - 1));
  return {
    header: { ...header, stages: made.map((stage) => stage.header) },
    sections: [...coordinates, ...made.flatMap(({ payloads }) => payloads)],
  };
}

export function fileOf(content: Content): Uint8Array<ArrayBuffer> {
  const { header, sections } = encode(content);
  return assemble(JSON.stringify(header), sections);
}

/** A random file: axes of each mode, and how its stages are. */
export function randomContent(draw: Draw, axes: number[][], wishes: Wish[]): Content {
  const trees = randomTree(draw, axes, wishes);
  const end = trees.findIndex((nodes) => nodes.length === 0); // where all nodes before are leaves
  const stages = trees.slice(0, end < 0 ? undefined : end).map((nodes, t): StageContent => {
    const isCut = nodes.some((node) => node.kind === "cut") && !nodes.some((node) => node.kind === "cells");
    const kind = isCut ? "cut" : wishes[t]!.kind;
    const step = kind === "coded" ? Math.fround(2 ** (draw(8) - 4) * 0.7) : null;
    const runs: number[] = [];
    for (let left = nodes.length; left > 0; left -= runs.at(-1)!) {
      runs.push(1 + draw(left));
    }
    const half = (): number => draw(0x7000) + 0x8000 * draw(2);
    const stored = nodes.map((node) => ({
      core: node.core.map(half), basis: node.basis.map((all) => all.map(half)),
      scale: list(node.kind === "cells" ? productOf(node.clusters) : 0, () => draw(100) / 8),
    }));
    return { nodes, runs, step: step === null ? null : Number(step.toPrecision(9)), isHalf: kind === "half", ...(kind === "half" ? { stored } : {}) };
  });
  let number = 0;
  const organisation = axes.map((mode) => mode.map(() => number++));
  return {
    stages, coordinates: [],
    header: {
      axes: axes.flat().map((size, n) => ({ name: `a${n}`, size })), organisation, dtype: "float32",
      quality: stages.filter(({ step, isHalf }) => step !== null || isHalf).map(() => ({ snr_db: 20, rmse: 0.5, max_abs_error: 1 })),
    },
  };
}
