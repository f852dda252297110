/**
 * The head of a shader: the constants of one model, the pages of its image, and the contraction of a core.
 *
 * The same text as `hmkcta.render.prelude` makes; `tests/corpus-render/prelude.json` holds the two together.
 */

import { axisPlaces } from "../decode/element";
import { Problem } from "../problem";
import type { Metadata } from "../reader/metadata";

/** Words of a page by its logarithm: 128 MiB, the storage buffer binding that WebGPU guarantees. */
export const PAGE_SHIFT = 25;
/** Of the 8 storage buffers that WebGPU guarantees a stage, those an image may take. */
const MOST_PAGES = 5;
/** Rows of a mode are kept in a mask of one word. */
const MOST_ROWS = 32;

export interface Options {
  picks?: number[]; // for each source axis, how many weighted indices it can have; 1 each by default
  channels?: 1 | 3;
  contracted?: number[]; // modes
  pageShift?: number;
}

/** Rows that each mode can have at once: the product of its axes' picks. */
function rooms(metadata: Metadata, picks: number[]): number[] {
  const result = metadata.modeSizes.map(() => 1);
  axisPlaces(metadata).forEach(({ mode }, axis) => {
    result[mode]! *= picks[axis]!;
  });
  return result;
}

/** Whether the decoder has room for so many weighted indices of each axis. */
export function picksFit(metadata: Metadata, picks: number[]): boolean {
  return rooms(metadata, picks).every((rows) => rows <= MOST_ROWS);
}

/** The constants and generated functions that the files of `hmkcta/shaders` are written against. */
export function prelude(metadata: Metadata, pages: number, options: Options = {}): string {
  const { picks = metadata.axes.map(() => 1), channels = 1, contracted = [], pageShift = PAGE_SHIFT } = options;
  const order = metadata.modeSizes.length;
  const places = axisPlaces(metadata);
  const room = rooms(metadata, picks);
  const first = [0];
  room.forEach((rows, n) => first.push(first[n]! + rows));
  return `${[
    "// Constants of one model: generated, not to be edited.",
    `const AXES = ${metadata.axes.length}u;`,
    `const ORDER = ${order}u;`,
    `const LEVELS = ${metadata.levels.length}u;`,
    `const UNDECOMPOSED = ${mask(metadata.undecomposed)}u;`,
    `const CONTRACTED = ${mask(contracted)}u;`,
    `const NODE_WORDS = ${nodeWords(order)}u;`,
    `const AXIS_MODE = ${list(places.map(({ mode }) => mode))};`,
    `const AXIS_STRIDE = ${list(places.map(({ stride }) => stride))};`,
    `const RANK_SUM = ${rankSum(metadata, room, contracted)}u;`,
    `const AXIS_PICKS = ${list(picks)};`,
    `const PICKS = ${Math.max(...picks)}u;`,
    `const ROW_FIRST = ${list(first)};`,
    `const ROWS = ${first[order]}u;`,
    `const CHANNELS = ${channels}u;`,
    `alias Value = ${channels === 3 ? "vec3f" : "f32"};`,
    "fn as_value(rgb: vec3f) -> Value {",
    `  return ${channels === 3 ? "rgb" : "rgb.x"};`,
    "}",
    ...pageLines(pages, pageShift),
    ...contractionLines(order, metadata.undecomposed, contracted),
  ].join("\n")}\n`;
}

/** Words of a node's record: child, core, scale, and C, K, R, rows, basis of every mode. */
export function nodeWords(order: number): number {
  return 3 + 5 * order;
}

/** Pages of an image of so many words. */
export function imagePages(words: number, pageShift = PAGE_SHIFT): number {
  const pages = Math.max(1, Math.ceil(words / 2 ** pageShift));
  if (pages > MOST_PAGES) {
    throw new Problem("The model is too large for the GPU.",
      `It takes ${Math.ceil((4 * words) / 2 ** 20)} MiB there; ${MOST_PAGES * 128} MiB can be used.`,
      "Compress it with a smaller --size.");
  }
  return pages;
}

const LARGEST = 3.4e38; // a little below the largest float32

/** The 16 bytes of the uniform `Decoder`. */
export function decoderUniform(metadata: Metadata, levels: number): ArrayBuffer {
  const { name, scale } = metadata.transform;
  const bounded = name === "log1p" || name === "asinh";
  const bytes = new ArrayBuffer(16);
  new Uint32Array(bytes).set([levels, ["identity", "log1p", "asinh", "sqrt"].indexOf(name)]);
  new Float32Array(bytes).set([scale, bounded ? Math.log(LARGEST / Math.max(scale, 1)) : 0], 2);
  return bytes;
}

function mask(modes: number[]): number {
  return modes.reduce((bits, n) => bits + 2 ** n, 0);
}

function list(numbers: number[]): string {
  return `array<u32, ${numbers.length}>(${numbers.map((number) => `${number}u`).join(", ")})`;
}

/** The most numbers that the weights of a cell take: R_n, or the rows where the mode is not decomposed. */
function rankSum(metadata: Metadata, room: number[], contracted: number[]): number {
  const sums = metadata.levels.map((level) => room.reduce((sum, rows, n) => {
    const taken = metadata.undecomposed.includes(n) ? rows : level.ranks[n]!;
    return contracted.includes(n) ? sum : sum + taken;
  }, 0));
  return Math.max(1, ...sums);
}

function pageLines(pages: number, shift: number): string[] {
  const numbers = Array.from({ length: pages }, (_, page) => page);
  const head = [
    `const PAGE_SHIFT = ${shift}u;`,
    ...numbers.map((page) => `@group(0) @binding(${page + 1}) var<storage, read> page_${page}: array<u32>;`),
    "fn word(at: u32) -> u32 {",
  ];
  if (pages === 1) {
    return [...head, "  return page_0[at];", "}"];
  }
  const inner = 2 ** shift - 1;
  return [
    ...head, "  switch at >> PAGE_SHIFT {",
    ...numbers.slice(0, -1).map((page) => `    case ${page}u: { return page_${page}[at & ${inner}u]; }`),
    `    default: { return page_${pages - 1}[at & ${inner}u]; }`, "  }", "}",
  ];
}

/** Functions `contract_0` to `contract_N`: the core of the cell at hand times its weights, mode by mode. */
function contractionLines(order: number, undecomposed: number[], contracted: number[]): string[] {
  const lines: string[] = [];
  for (let n = 0; n < order; n += 1) {
    lines.push(`fn contract_${n}(at: u32) -> Value {`);
    if (contracted.includes(n)) {
      lines.push(`  return contract_${n + 1}(at);`, "}");
      continue;
    }
    const index = undecomposed.includes(n) ? `cell_index[cell_first[${n}] + e]` : "e";
    lines.push(
      "  var sum = Value(0.0);",
      `  for (var e = 0u; e < cell_count[${n}]; e++) {`,
      `    sum += cell_weight[cell_first[${n}] + e] * contract_${n + 1}(at * node_rank[${n}] + ${index});`,
      "  }", "  return sum;", "}",
    );
  }
  const folded = contracted.length > 0;
  if (folded) {
    lines.push("@group(0) @binding(8) var<storage, read> frame: array<u32>;");
  }
  const number = folded ? "bitcast<f32>(frame[cell_core + at])" : "coefficient(cell_core + at)";
  const start = folded ? "frame[node / NODE_WORDS]" : "word(node + 1u)";
  return [...lines, `fn contract_${order}(at: u32) -> Value {`, `  return Value(${number});`, "}",
    "fn node_core(node: u32) -> u32 {", `  return ${start};`, "}"];
}
