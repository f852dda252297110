/**
 * Frame contraction: modes that stand still for a frame are summed into the cores once (`contract.wgsl`). Twin of
 * `hmkcta.render.contract`.
 */

import { axisPlaces } from "../decode/element";
import type { Metadata } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";
import type { Decoder } from "./decoder";
import { MOST_ROWS, type Options, PAGE_SHIFT, nodeWords, prelude, rooms } from "./prelude";
import { compose } from "./shaders";

/** Indices of an axis and their weights. */
export type Still = Map<number, { index: number[]; weight: number[] }>;

const GROUP = 64; // invocations of a workgroup
const MOST_GROUPS = 65535; // along one dimension
const FIXED_WORDS = 1 + 2 * MOST_ROWS; // of a mode in `fixed_rows`

/** The modes to contract where these source axes stand still; none if their cores would not fit into one binding. */
export function contractable(metadata: Metadata, levels: PackedLevel[], still: number[]): number[] {
  const places = axisPlaces(metadata);
  const found = metadata.modeSizes.flatMap((_, n) =>
    (places.every(({ mode }, axis) => mode !== n || still.includes(axis)) ? [n] : []));
  return coreWords(levels, found) <= 2 ** PAGE_SHIFT ? found : [];
}

/** The modes of a decoder that pay: an array that is no more than packed has one core, of which a frame takes a part anyway. */
export function contractedModes({ metadata, levels }: Decoder, still: number[]): number[] {
  return metadata.undecomposed.length === metadata.modeSizes.length ? [] : contractable(metadata, levels, still);
}

/** The constants that `contract.wgsl` needs beside the prelude with nothing contracted. */
export function contractionConstants(
  metadata: Metadata, levels: PackedLevel[], scales: [number, number], options: Options,
): Record<string, number> {
  const { contracted = [], picks = metadata.axes.map(() => 1) } = options;
  const room = rooms(metadata, picks);
  const taken = metadata.levels.map(({ ranks }) => contracted.reduce((sum, n) =>
    sum + (metadata.undecomposed.includes(n) ? room[n]! : ranks[n]!), 0));
  const most = levels.reduce((largest, level) => {
    for (let s = 0; s < level.nodes; s += 1) {
      largest = Math.max(largest, numbers(level, s, contracted));
    }
    return largest;
  }, 1);
  return {
    FOLDED: contracted.reduce((bits, n) => bits + 2 ** n, 0), FOLD_SUM: Math.max(1, ...taken),
    LANES: Math.min(GROUP, 2 ** Math.ceil(Math.log2(most))), NODES: levels.reduce((sum, { nodes }) => sum + nodes, 0),
    SCALES: scales[0], CELLS: scales[1] - scales[0],
  };
}

/** For each node of all levels the start of its contracted cores, which lie behind these numbers. */
export function coreStarts(levels: PackedLevel[], contracted: number[]): Uint32Array<ArrayBuffer> {
  const starts: number[] = [];
  let at = levels.reduce((sum, { nodes }) => sum + nodes, 0);
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

/** The contracted cores of a model on the GPU, and the pass that fills them. */
export class FrameContraction {
  readonly cores: GPUBuffer;
  private done = ""; // what the cores are contracted for

  private constructor(
    private readonly device: GPUDevice, private readonly decoder: Decoder, private readonly contracted: number[],
    private readonly pipeline: GPUComputePipeline, private readonly own: GPUBindGroup,
    private readonly buffers: { cores: GPUBuffer; parents: GPUBuffer; fixed: GPUBuffer }, private readonly groups: number,
  ) {
    this.cores = buffers.cores;
  }

  /** Compile the pass; `options` have the contracted modes, and the picks that leave room for their axes'. */
  static async make(device: GPUDevice, decoder: Decoder, options: Options): Promise<FrameContraction> {
    const { metadata, levels } = decoder;
    const { contracted = [] } = options;
    const storage = (size: number): GPUBuffer =>
      device.createBuffer({ size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
    const parents = parentTable(levels);
    const buffers = {
      fixed: storage(4 * FIXED_WORDS * metadata.modeSizes.length), parents: storage(parents.byteLength),
      cores: storage(4 * coreWords(levels, contracted)),
    };
    device.queue.writeBuffer(buffers.parents, 0, parents);
    device.queue.writeBuffer(buffers.cores, 0, coreStarts(levels, contracted));
    const layout = device.createBindGroupLayout({
      entries: (["read-only-storage", "read-only-storage", "storage"] as const).map((type, binding) => (
        { binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } })),
    });
    const constants = contractionConstants(metadata, levels, decoder.scales, options);
    const pipeline = await device.createComputePipelineAsync({
      layout: device.createPipelineLayout({ bindGroupLayouts: [decoder.layout, layout] }),
      compute: { module: device.createShaderModule({ code: contractionShader(decoder, constants) }), entryPoint: "contract_frame" },
    });
    const own = device.createBindGroup({
      layout, entries: [buffers.fixed, buffers.parents, buffers.cores].map((buffer, binding) => ({ binding, resource: { buffer } })),
    });
    return new FrameContraction(device, decoder, contracted, pipeline, own, buffers,
      Math.ceil((constants["CELLS"]! * constants["LANES"]!) / GROUP));
  }

  /** Contract the cores of the levels that are there, unless they are for these indices and weights already. */
  run(picks: Still): void {
    const wanted = JSON.stringify([this.decoder.arrived, ...picks]);
    if (wanted === this.done) {
      return;
    }
    this.done = wanted;
    this.device.queue.writeBuffer(this.buffers.fixed, 0, fixedRows(this.decoder.metadata, this.contracted, picks));
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.decoder.group(this.decoder.metadata.levels.length));
    pass.setBindGroup(1, this.own);
    const across = Math.min(this.groups, MOST_GROUPS);
    pass.dispatchWorkgroups(across, Math.ceil(this.groups / across));
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }

  destroy(): void {
    Object.values(this.buffers).forEach((buffer) => buffer.destroy());
  }
}

/** The text of the pass. */
function contractionShader(decoder: Decoder, constants: Record<string, number>): string {
  const lines = Object.entries(constants).map(([name, value]) => `const ${name} = ${value}u;\n`).join("");
  return compose(prelude(decoder.metadata, decoder.pages) + lines, "image", "contract");
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

/** Words of the table of starts and of all contracted cores. */
function coreWords(levels: PackedLevel[], contracted: number[]): number {
  let words = 0;
  for (const level of levels) {
    words += level.nodes;
    for (let s = 0; s < level.nodes; s += 1) {
      words += cells(level, s) * numbers(level, s, contracted);
    }
  }
  return words;
}
