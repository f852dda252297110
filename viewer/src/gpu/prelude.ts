/**
 * The head of a shader: the constants of one model, the pages of its image, and the contraction of a core.
 *
 * With `picked.ts` the same text as `hmkcta.render.prelude` makes; `tests/corpus-render/prelude.json` holds the two together.
 */

import { axisPlaces } from "../decode/element";
import { Problem } from "../problem";
import { type Metadata, levelEnds } from "../reader/metadata";
import { contraction } from "./coreSums";
import { type Tree, mostWeights } from "./tree";

/** Words of a page by its logarithm: 128 MiB, the storage buffer binding that WebGPU guarantees. */
export const PAGE_SHIFT = 25;
/** Of the 8 storage buffers that WebGPU guarantees a stage, those an image may take. */
const MOST_PAGES = 5;
/** Rows of a mode are kept in a mask of one word. */
export const MOST_ROWS = 32;

export interface Options {
  picks?: number[]; // for each source axis, how many weighted indices it can have; none for shaders without weighted.wgsl
  channels?: 1 | 3;
  contracted?: number[]; // modes
  pageShift?: number;
}

/** Rows that each mode can have at once: the product of its axes' picks. */
export function rooms(metadata: Metadata, picks: number[]): number[] {
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

/** The constants and generated functions that the files of `hmkcta/shaders` are written against, but for `weighted.wgsl`. */
export function prelude(tree: Tree, pages: number, options: Options = {}): string {
  const { metadata } = tree;
  const { picks = metadata.axes.map(() => 1), channels = 1, contracted = [], pageShift = PAGE_SHIFT } = options;
  const order = metadata.modeSizes.length;
  const places = axisPlaces(metadata);
  const room = rooms(metadata, picks);
  const taken = room.map((rows, n) => (contracted.includes(n) ? 0 : mostWeights(tree, n, rows)));
  const { colour, tinted } = colourMode(metadata, options);
  const channelAxis = metadata.axes.findIndex((axis) => axis.role === "channel");
  const first = [0];
  room.forEach((rows, n) => first.push(first[n]! + rows));
  return `${[
    "// Constants of one model: generated, not to be edited.",
    `const AXES = ${metadata.axes.length}u;`,
    `const ORDER = ${order}u;`,
    `const STAGES = ${metadata.stages.length}u;`,
    `const CUTS = ${tree.cuts};`,
    `const UNDECOMPOSED = ${mask(tree.undecomposed)}u;`,
    `const MIXED = ${mask(tree.mixed)}u;`,
    `const WHOLE = ${mask(tree.whole)}u;`,
    `const CONTRACTED = ${mask(contracted)}u;`,
    `const NODE_WORDS = ${nodeWords(order)}u;`,
    `const AXIS_MODE = ${list(places.map(({ mode }) => mode))};`,
    `const AXIS_STRIDE = ${list(places.map(({ stride }) => stride))};`,
    `const RANK_SUM = ${Math.max(1, taken.reduce((sum, each) => sum + each, 0))}u;`,
    `const WEIGHT_FIRST = ${list(taken.map((_, n) => taken.slice(0, n).reduce((sum, each) => sum + each, 0)))};`,
    `const AXIS_PICKS = ${list(picks)};`,
    `const PICKS = ${Math.max(...picks)}u;`,
    `const ROW_FIRST = ${list(first)};`,
    `const ROWS = ${first[order]}u;`,
    `const TRANSFORM = ${transformNumber(metadata)}u;`,
    `const CHANNELS = ${channels}u;`,
    `alias Value = ${channels === 3 ? "vec3f" : "f32"};`,
    "fn channel(c: u32) -> Value {",
    `  return ${channels === 3 ? "vec3f(f32(c == 0u), f32(c == 1u), f32(c == 2u))" : "1.0"};`,
    "}",
    `const COLOUR_AXIS = ${channels === 3 && channelAxis >= 0 ? channelAxis : 0xff}u;`,
    `const COLOUR = ${colour ?? 0xff}u;`,
    `const COLOUR_ROWS = ${colour === undefined ? 1 : room[colour]!}u;`,
    `const COLOUR_RANKS = ${colour === undefined ? 1 : Math.max(taken[colour]!, 1)}u;`,
    ...pageLines(pages, pageShift),
    ...contraction(tree, taken, colour, contracted, tinted),
  ].join("\n")}\n`;
}

/** The mode whose weights are colours; or, where it is contracted, that the cores are (`tinted`). */
export function colourMode(metadata: Metadata, { channels = 1, contracted = [] }: Options): { colour: number | undefined; tinted: boolean } {
  const mode = channels === 1 ? undefined : axisPlaces(metadata)[metadata.axes.findIndex((axis) => axis.role === "channel")]?.mode;
  const tinted = mode !== undefined && contracted.includes(mode);
  return { colour: tinted ? undefined : mode, tinted };
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

function transformNumber(metadata: Metadata): number {
  return ["identity", "log1p", "asinh", "sqrt"].indexOf(metadata.transform.name);
}

/** The 12 bytes of the uniform `Decoder` for so many levels. */
export function decoderUniform(metadata: Metadata, levels: number): ArrayBuffer {
  const { name, scale } = metadata.transform;
  const limit = { identity: 0, log1p: Math.log1p(LARGEST / scale), asinh: Math.asinh(LARGEST / scale), sqrt: Math.sqrt(LARGEST) };
  const bytes = new ArrayBuffer(12);
  new Uint32Array(bytes).set([levelEnds(metadata)[levels - 1]!]);
  new Float32Array(bytes).set([scale, limit[name]], 1);
  return bytes;
}

function mask(modes: number[]): number {
  return modes.reduce((bits, n) => bits + 2 ** n, 0);
}

function list(numbers: number[]): string {
  return `array<u32, ${numbers.length}>(${numbers.map((number) => `${number}u`).join(", ")})`;
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
