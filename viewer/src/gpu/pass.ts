/** One compute pass: pipeline, the decoder's bindings if it decodes, and its own in group 1. */

import { compose, type SHADERS } from "./shaders";
import { UniformLayout, type Values } from "./uniform";

type Resource = GPUBuffer | GPUTexture;

interface Description {
  entry: string;
  struct: string; // of the uniform, binding 1.0
  shaders: (keyof typeof SHADERS)[];
  head?: string; // prelude and further generated lines
  decoder?: GPUBindGroupLayout;
  /** What bindings 1, 2, .. of group 1 are. */
  bindings: ("storage" | "texture-2d" | "texture-3d" | "store-2d" | "store-3d" | "store-8")[];
}

const STORED: Record<string, GPUStorageTextureBindingLayout> = {
  "store-2d": { access: "write-only", format: "rgba32float" },
  "store-3d": { access: "write-only", format: "r32float", viewDimension: "3d" },
  "store-8": { access: "write-only", format: "rgba8unorm" },
};

function bindingOf(kind: Description["bindings"][number]): Partial<GPUBindGroupLayoutEntry> {
  if (kind === "storage") {
    return { buffer: { type: "read-only-storage" } };
  }
  if (kind.startsWith("texture")) {
    return { texture: { sampleType: "unfilterable-float", viewDimension: kind === "texture-3d" ? "3d" : "2d" } };
  }
  return { storageTexture: STORED[kind]! };
}

export class Pass {
  readonly uniform: GPUBuffer;
  private readonly layout: GPUBindGroupLayout;
  private readonly fields: UniformLayout;

  private constructor(
    private readonly device: GPUDevice, private readonly pipeline: GPUComputePipeline, layout: GPUBindGroupLayout,
    fields: UniformLayout,
  ) {
    this.layout = layout;
    this.fields = fields;
    this.uniform = device.createBuffer({ size: fields.size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }

  /** Compile a pass; takes a while, and does not block the page. */
  static async make(device: GPUDevice, description: Description): Promise<Pass> {
    const { entry, struct, shaders, head = "", decoder, bindings } = description;
    const code = compose(head, ...shaders);
    const own = device.createBindGroupLayout({
      entries: [{ buffer: { type: "uniform" as const } }, ...bindings.map(bindingOf)].map((each, binding) => (
        { binding, visibility: GPUShaderStage.COMPUTE, ...each })),
    });
    const first = decoder ?? device.createBindGroupLayout({ entries: [] });
    const pipeline = await device.createComputePipelineAsync({
      layout: device.createPipelineLayout({ bindGroupLayouts: [first, own] }),
      compute: { module: device.createShaderModule({ code }), entryPoint: entry },
    });
    return new Pass(device, pipeline, own, new UniformLayout(code, struct));
  }

  /** Fill the uniform and submit the pass over so many invocations. */
  run(values: Values, resources: Resource[], size: [number, number, number], decoder?: GPUBindGroup): void {
    this.device.queue.writeBuffer(this.uniform, 0, this.fields.pack(values));
    const group = this.device.createBindGroup({
      layout: this.layout,
      entries: [this.uniform, ...resources].map((each, binding) => (
        { binding, resource: each instanceof GPUBuffer ? { buffer: each } : each.createView() })),
    });
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.pipeline);
    if (decoder !== undefined) {
      pass.setBindGroup(0, decoder);
    }
    pass.setBindGroup(1, group);
    pass.dispatchWorkgroups(Math.ceil(size[0] / 8), Math.ceil(size[1] / 8), size[2]);
    pass.end();
    this.device.queue.submit([encoder.finish()]); // at once: the uniform is used again by the next run
  }

  destroy(): void {
    this.uniform.destroy();
  }
}
