/** What each pixel sees of a mesh, by the rasteriser (`gbuffer.wgsl`); drawn anew only when camera, mesh or size change. */

import { SHADERS } from "../gpu/shaders";
import type { State } from "../state";
import { type Mesh, type MeshMaker, VERTEX_NUMBERS, makeMesh } from "./mesh";
import { filledBuffer } from "./renderer";
import { type Rays, cameraRays, clipFromWorld } from "./vector";

const [NEAR, FAR] = [1e-2, 100];
const TARGETS: GPUTextureFormat[] = ["rgba32float", "rgba16float", "rgba16float"];

/** A mesh on the GPU. */
interface Drawn {
  key: string;
  vertices: GPUBuffer;
  indices: GPUBuffer;
  count: number;
}

export class Surface {
  /** Texture coordinates and distance, normal, tangent. */
  seen: GPUTexture[] = [];
  private depth: GPUTexture | null = null;
  private pipeline: GPURenderPipeline | null = null;
  private readonly uniform: GPUBuffer;
  private custom: MeshMaker | null = null;
  private meshes = 0;
  private mesh: Drawn | null = null;
  private key = ""; // what `seen` shows

  constructor(private readonly device: GPUDevice, readonly rows: number, readonly columns: number) {
    this.uniform = device.createBuffer({ size: 80, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }

  async compile(): Promise<void> {
    this.pipeline = await makeRasteriser(this.device);
  }

  /** Take a mesh of the user's for the shape "mesh". */
  setMesh(make: MeshMaker): void {
    this.custom = make;
    this.meshes += 1;
  }

  /** Draw what is seen, unless it is there; returns the rays of the camera. */
  draw(state: State, width: number, height: number): Rays {
    const rays = cameraRays(state.camera, width / height);
    const mesh = this.prepareMesh(state);
    const key = JSON.stringify([mesh.key, width, height, rays]);
    if (key !== this.key) {
      this.prepareTargets(width, height);
      this.rasterise(mesh, rays);
      this.key = key;
    }
    return rays;
  }

  /** Have the mesh of a state on the GPU. */
  prepareMesh(state: State): Drawn {
    const { shape, repeat } = state.surface;
    const key = JSON.stringify([shape, repeat, this.meshes]);
    if (this.mesh?.key !== key) {
      this.mesh?.vertices.destroy();
      this.mesh?.indices.destroy();
      const custom = shape === "mesh" ? this.custom : null;
      this.mesh = uploaded(this.device, key, custom === null
        ? makeMesh(shape === "mesh" ? "sphere" : shape, repeat, this.rows, this.columns) : custom(repeat));
    }
    return this.mesh;
  }

  destroy(): void {
    [this.uniform, this.mesh?.vertices, this.mesh?.indices, ...this.seen, this.depth].forEach((each) => each?.destroy());
  }

  private rasterise(mesh: Drawn, rays: Rays): void {
    const uniform = new Float32Array(20);
    uniform.set(clipFromWorld(rays, NEAR, FAR));
    uniform.set(rays.eye, 16);
    this.device.queue.writeBuffer(this.uniform, 0, uniform);
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: this.seen.map((texture) => (
        { view: texture.createView(), loadOp: "clear" as const, storeOp: "store" as const, clearValue: [0, 0, 0, 0] })),
      depthStencilAttachment: {
        view: this.depth!.createView(), depthLoadOp: "clear", depthStoreOp: "discard", depthClearValue: 1,
      },
    });
    pass.setPipeline(this.pipeline!);
    pass.setBindGroup(0, this.device.createBindGroup({
      layout: this.pipeline!.getBindGroupLayout(0), entries: [{ binding: 0, resource: { buffer: this.uniform } }],
    }));
    pass.setVertexBuffer(0, mesh.vertices);
    pass.setIndexBuffer(mesh.indices, "uint32");
    pass.drawIndexed(mesh.count);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }

  private prepareTargets(width: number, height: number): void {
    if (this.depth?.width === width && this.depth.height === height) {
      return;
    }
    [...this.seen, this.depth].forEach((texture) => texture?.destroy());
    const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING;
    this.seen = TARGETS.map((format) => this.device.createTexture({ size: [width, height], format, usage }));
    this.depth = this.device.createTexture({
      size: [width, height], format: "depth32float", usage: GPUTextureUsage.RENDER_ATTACHMENT,
    });
  }
}

function uploaded(device: GPUDevice, key: string, mesh: Mesh): Drawn {
  return {
    key, vertices: filledBuffer(device, mesh.vertices, GPUBufferUsage.VERTEX),
    indices: filledBuffer(device, mesh.indices, GPUBufferUsage.INDEX), count: mesh.indices.length,
  };
}

function makeRasteriser(device: GPUDevice): Promise<GPURenderPipeline> {
  const module = device.createShaderModule({ code: SHADERS.gbuffer });
  const attributes = [[0, "float32x3"], [12, "float32x3"], [24, "float32x4"], [40, "float32x2"]] as const;
  return device.createRenderPipelineAsync({
    layout: "auto",
    vertex: {
      module, entryPoint: "surface_vertex",
      buffers: [{
        arrayStride: 4 * VERTEX_NUMBERS,
        attributes: attributes.map(([offset, format], shaderLocation) => ({ shaderLocation, offset, format })),
      }],
    },
    fragment: { module, entryPoint: "surface_fragment", targets: TARGETS.map((format) => ({ format })) },
    depthStencil: { format: "depth32float", depthWriteEnabled: true, depthCompare: "less" },
  });
}
