// Compiles and runs the shaders of a list of jobs (gpu_tools.py) with Dawn for Node; prints the last buffers as JSON.
import { readFileSync } from "node:fs";

const [, , dawn, listed] = process.argv;
const { create, globals } = await import(dawn);
Object.assign(globalThis, globals);
const gpu = create([]);
const adapter = await gpu.requestAdapter();
if (!adapter) {
  throw new Error("Dawn found no adapter");
}
const device = await adapter.requestDevice(); // with WebGPU's guaranteed limits

function buffer({ type, data }) {
  const bytes = Buffer.from(data, "base64");
  const usage = type === "uniform" ? GPUBufferUsage.UNIFORM : GPUBufferUsage.STORAGE;
  const made = device.createBuffer({ size: bytes.length, usage: usage | GPUBufferUsage.COPY_SRC | GPUBufferUsage.COPY_DST });
  device.queue.writeBuffer(made, 0, bytes);
  return made;
}

async function run({ code, entry, groups, counts }) {
  device.pushErrorScope("validation");
  const module = device.createShaderModule({ code });
  let read = Buffer.alloc(0);
  const { messages } = await module.getCompilationInfo();
  const wrong = messages.filter((message) => message.type === "error");
  if (wrong.length) {
    const lines = code.split("\n");
    throw new Error(wrong.map((m) => `line ${m.lineNum}: ${m.message}\n  ${lines[m.lineNum - 1]}`).join("\n"));
  }
  if (entry) {
    const buffers = groups.map((group) => group.map(buffer));
    const layouts = groups.map((group) => device.createBindGroupLayout({
      entries: group.map(({ type }, binding) => ({ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } })),
    }));
    const pipeline = device.createComputePipeline({
      layout: device.createPipelineLayout({ bindGroupLayouts: layouts }), compute: { module, entryPoint: entry },
    });
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(pipeline);
    buffers.forEach((group, number) => pass.setBindGroup(number, device.createBindGroup({
      layout: layouts[number], entries: group.map((made, binding) => ({ binding, resource: { buffer: made } })),
    })));
    pass.dispatchWorkgroups(...counts);
    pass.end();
    const last = buffers.at(-1).at(-1);
    const copy = device.createBuffer({ size: last.size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    encoder.copyBufferToBuffer(last, 0, copy, 0, last.size);
    device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    read = Buffer.from(copy.getMappedRange().slice(0));
  }
  const error = await device.popErrorScope();
  if (error) {
    throw new Error(error.message);
  }
  return read.toString("base64");
}

const results = [];
for (const job of JSON.parse(readFileSync(listed, "utf8"))) {
  results.push(await run(job));
}
process.stdout.write(JSON.stringify(results), () => process.exit(0));
