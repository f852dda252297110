/**
 * Frame contraction: modes that stand still for a frame are summed into the cores once (`contract.wgsl`). Twin of
 * `hmkcta.render.frame_contraction`.
 */

import { axisPlaces } from "../decode/element";
import type { Metadata } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";
import type { Decoder } from "./decoder";
import { MOST_ROWS, type Options, PAGE_SHIFT, colourMode, nodeWords, prelude, rooms } from "./prelude";
import { compose } from "./shaders";
import { type Tree, mostWeights } from "./tree";

/** Indices of an axis and their weights. */
export type Still = Map<number, { index: number[]; weight: number[] }>;

const GROUP = 64; // invocations of a workgroup
const MOST_GROUPS = 65535; // along one dimension
const FIXED_WORDS = 1 + 2 * MOST_ROWS; // of a mode in `fixed_rows`

/** The modes to contract where these source axes stand still; none if their cores, so many times, would not fit into one binding. */
export function contractable(metadata: Metadata, stages: PackedLevel[], still: number[], folds = 1): number[] {
  const places = axisPlaces(metadata);
  const found = metadata.modeSizes.flatMap((_, n) =>
    (places.every(({ mode }, axis) => mode !== n || still.includes(axis)) ? [n] : []));
  return coreWords(stages, found, folds) <= 2 ** PAGE_SHIFT ? found : [];
}

/** The modes of a decoder that pay: an array that is no more than packed has one core, of which a frame takes a part anyway. */
export function contractedModes({ metadata, stages, tree }: Decoder, still: number[]): number[] {
  return tree.undecomposed.length === metadata.modeSizes.length ? [] : contractable(metadata, stages, still);
}

/** The constants that `contract.wgsl` needs beside the prelude with nothing contracted. */
export function contractionConstants(
  tree: Tree, stages: PackedLevel[], scales: [number, number], options: Options,
): Record<string, number> {
  const { metadata } = tree;
  const { contracted = [], picks = metadata.axes.map(() => 1) } = options;
  const room = rooms(metadata, picks);
  const most = stages.reduce((largest, level) => {
    for (let s = 0; s < level.nodes; s += 1) {
      largest = Math.max(largest, numbers(level, s, contracted));
    }
    return largest;
  }, 1);
  return {
    FOLDED: contracted.reduce((bits, n) => bits + 2 ** n, 0), FOLD_SUM: Math.max(1, contracted.reduce((sum, n) => sum + mostWeights(tree, n, room[n]!), 0)),
    LANES: Math.min(GROUP, 2 ** Math.ceil(Math.log2(most))), FOLD_CHANNELS: foldChannels(metadata, options),
    SET_NUMBERS: setNumbers(stages, contracted), NODES: stages.reduce((sum, { nodes }) => sum + nodes, 0),
    SCALES: scales[0], CELLS: scales[1] - scales[0],
  };
}

/** Of a number of the contracted cores: 3 where they hold colours. */
export function foldChannels(metadata: Metadata, options: Options): 1 | 3 {
  return colourMode(metadata, options).tinted ? 3 : 1;
}

/** For each node of all levels the start of its contracted cores, in numbers of so many words; they lie behind these. */
export function coreStarts(levels: PackedLevel[], contracted: number[], channels = 1): Uint32Array<ArrayBuffer> {
  const starts: number[] = [];
  let at = Math.ceil(levels.reduce((sum, { nodes }) => sum + nodes, 0) / channels);
  for (const level of levels) {
    for (let s = 0; s < level.nodes; s += 1) {
      starts.push(at);
      at += cells(level, s) * numbers(level, s, contracted);
    }
  }
  return Uint32Array.from(starts);
}

/** For each node of all levels the address of its parent's record and its number among the children. */
export function parentTable(levels: PackedLevel[]): Uint32Array<ArrayBuffer> {
  const table = [0, 0];
  let first = 0;
  for (const { child, nodes, order } of levels.slice(0, -1)) {
    for (let s = 0; s < nodes; s += 1) {
      for (let number = 0; number < child![s + 1]! - child![s]!; number += 1) {
        table.push((first + s) * nodeWords(order), number);
      }
    }
    first += nodes;
  }
  return Uint32Array.from(table);
}

/** What `contract.wgsl` reads: for each mode the rows that its axes' picks make, and their weights. */
export function fixedRows(metadata: Metadata, contracted: number[], picks: Still): Uint32Array<ArrayBuffer> {
  const places = axisPlaces(metadata);
  const table = new Uint32Array(FIXED_WORDS * metadata.modeSizes.length);
  const bits = new Float32Array(table.buffer);
  for (const n of contracted) {
    let rows: [number, number][] = [[0, 1]];
    places.forEach(({ mode, stride }, axis) => {
      if (mode === n) {
        const { index, weight } = picks.get(axis)!;
        rows = rows.flatMap(([row, share]) => index.map((i, k): [number, number] => [row + i * stride, share * weight[k]!]));
      }
    });
    table[n * FIXED_WORDS] = rows.length;
    table.set(rows.map(([row]) => row), n * FIXED_WORDS + 1);
    bits.set(rows.map(([, share]) => share), n * FIXED_WORDS + 1 + MOST_ROWS);
  }
  return table;
}

/** What `contract.wgsl` takes and makes, for so many sets of cores. */
interface Buffers {
  sets: number;
  cores: GPUBuffer;
  fixed: GPUBuffer;
  own: GPUBindGroup;
}

/** How a model is decoded in a frame: with modes contracted into cores of its own, or, where there are none, as it is. */
export class FrameContraction {
  /** Numbers from one set of cores to the next: what `frame_first` counts in. */
  readonly stride: number;
  private readonly channels: 1 | 3;
  private readonly parents: GPUBuffer;
  private readonly bindings: GPUBindGroupLayout;
  private pipeline: GPUComputePipeline | null = null;
  private buffers: Buffers | null = null;
  private done = ""; // what the cores are contracted for

  /** `options` have the contracted modes, and the picks that leave room for their axes'. */
  constructor(private readonly device: GPUDevice, private readonly decoder: Decoder, private readonly options: Options) {
    const { metadata, stages } = decoder;
    this.stride = setNumbers(stages, this.contracted);
    this.channels = foldChannels(metadata, options);
    const parents = parentTable(stages);
    this.parents = this.storage(parents.byteLength);
    device.queue.writeBuffer(this.parents, 0, parents);
    this.bindings = device.createBindGroupLayout({
      entries: (["read-only-storage", "read-only-storage", "storage"] as const).map((type, binding) => (
        { binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } })),
    });
  }

  /** Compile the pass, if any is needed. */
  async compile(): Promise<void> {
    if (this.contracted.length > 0) {
      const { device, decoder } = this;
      this.pipeline = await device.createComputePipelineAsync({
        layout: device.createPipelineLayout({ bindGroupLayouts: [decoder.layout, this.bindings] }),
        compute: { module: device.createShaderModule({ code: contractionShader(decoder, this.constants) }), entryPoint: "contract_frame" },
      });
    }
  }

  /** The modes. */
  get contracted(): number[] {
    return this.options.contracted ?? [];
  }

  /** Of group 0 of the shaders that decode. */
  get layout(): GPUBindGroupLayout {
    return this.contracted.length > 0 ? this.decoder.framed : this.decoder.layout;
  }

  /** Group 0 with so many levels. */
  group(levels: number): GPUBindGroup {
    return this.decoder.group(levels, this.buffers?.cores);
  }

  /** Whether there is room for so many sets of cores. */
  fits(sets: number): boolean {
    return coreWords(this.decoder.stages, this.contracted, sets * this.channels) <= 2 ** PAGE_SHIFT;
  }

  /**
   * Contract the cores of the levels that are there, a set for each of these indices and weights, unless they are for
   * them already. The axis of the colours, where their mode is contracted, has the indices of red, green and blue.
   */
  run(sets: Still[]): void {
    const wanted = JSON.stringify([this.decoder.arrived, ...sets.map((picks) => [...picks])]);
    if (this.pipeline === null || wanted === this.done) {
      return;
    }
    this.done = wanted;
    const { own, fixed } = this.reserve(sets.length);
    const folds = sets.flatMap((picks) => splitColours(this.decoder.metadata, picks, this.channels));
    folds.forEach((picks, fold) => {
      const rows = fixedRows(this.decoder.metadata, this.contracted, picks);
      this.device.queue.writeBuffer(fixed, fold * rows.byteLength, rows);
    });
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.decoder.group(this.decoder.metadata.levels.length));
    pass.setBindGroup(1, own);
    const { CELLS, LANES } = this.constants;
    const groups = Math.ceil((CELLS! * LANES!) / GROUP);
    const across = Math.min(groups, MOST_GROUPS);
    pass.dispatchWorkgroups(across, Math.ceil(groups / across), folds.length);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }

  destroy(): void {
    this.release();
    this.parents.destroy();
  }

  private get constants(): Record<string, number> {
    return contractionConstants(this.decoder.tree, this.decoder.stages, this.decoder.scales, this.options);
  }

  private storage(size: number): GPUBuffer {
    return this.device.createBuffer({ size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
  }

  /** The buffers, with room for so many sets. */
  private reserve(sets: number): Buffers {
    if (this.buffers !== null && this.buffers.sets >= sets) {
      return this.buffers;
    }
    this.release();
    const { metadata, stages } = this.decoder;
    const folds = sets * this.channels;
    const cores = this.storage(4 * coreWords(stages, this.contracted, folds));
    const fixed = this.storage(4 * FIXED_WORDS * metadata.modeSizes.length * folds);
    this.device.queue.writeBuffer(cores, 0, coreStarts(stages, this.contracted, this.channels));
    const own = this.device.createBindGroup({
      layout: this.bindings, entries: [fixed, this.parents, cores].map((buffer, binding) => ({ binding, resource: { buffer } })),
    });
    this.buffers = { sets, cores, fixed, own };
    return this.buffers;
  }

  private release(): void {
    if (this.buffers !== null) {
      this.decoder.forget(this.buffers.cores);
      this.buffers.cores.destroy();
      this.buffers.fixed.destroy();
      this.buffers = null;
    }
  }
}

/** The picks of each channel of the contracted cores: of red, green and blue, or the picks themselves. */
function splitColours(metadata: Metadata, picks: Still, channels: 1 | 3): Still[] {
  const axis = metadata.axes.findIndex(({ role }) => role === "channel");
  return channels === 1 ? [picks] : picks.get(axis)!.index.map((index) => new Map([...picks, [axis, { index: [index], weight: [1] }]]));
}

/** The text of the pass. */
function contractionShader(decoder: Decoder, constants: Record<string, number>): string {
  const lines = Object.entries(constants).map(([name, value]) => `const ${name} = ${value}u;\n`).join("");
  return compose(prelude({ ...decoder.tree, uniform: [] }, decoder.pages) + lines, "image", "contract");
}

/** PC of a node, 0 where the shape is zero. */
function cells(level: PackedLevel, s: number): number {
  return level.cellOffset[s + 1]! - level.cellOffset[s]!;
}

/** Numbers of a node's contracted core. */
function numbers({ order, shape }: PackedLevel, s: number, contracted: number[]): number {
  let product = 1;
  for (let n = 0; n < order; n += 1) {
    product *= contracted.includes(n) ? 1 : shape[(3 * s + 2) * order + n]!;
  }
  return product;
}

/** Numbers of all contracted cores. */
function setNumbers(levels: PackedLevel[], contracted: number[]): number {
  let sum = 0;
  for (const level of levels) {
    for (let s = 0; s < level.nodes; s += 1) {
      sum += cells(level, s) * numbers(level, s, contracted);
    }
  }
  return sum;
}

/** Words of the table of starts, with what rounds it up, and of all contracted cores, so many times. */
function coreWords(levels: PackedLevel[], contracted: number[], folds: number): number {
  return levels.reduce((sum, { nodes }) => sum + nodes, 0) + 2 + folds * setNumbers(levels, contracted);
}
