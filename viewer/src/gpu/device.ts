/** The GPU: found, or a sentence on why not. */

import { Problem } from "../problem";

export interface Gpu {
  device: GPUDevice;
  name: string;
}

const BROWSERS = "Use a current Chrome or Edge, Safari 26, or Firefox 141 and later, and update the graphics driver.";

/** Open the GPU, with as large textures and buffers as it offers; `onLost` is told when it goes away. */
export async function openGpu(onLost: (problem: Problem) => void): Promise<Gpu> {
  if (!("gpu" in navigator)) {
    throw window.isSecureContext
      ? new Problem("This browser has no WebGPU, which this page decodes with.", "", BROWSERS)
      : new Problem("Browsers offer WebGPU to secure pages only.", `This one came from ${location.origin}.`,
        "Open it by https, or on this computer by http://127.0.0.1.");
  }
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  if (adapter === null) {
    throw new Problem("The browser has WebGPU, but found no graphics adapter for it.", "", BROWSERS);
  }
  const { maxBufferSize, maxTextureDimension2D } = adapter.limits;
  const device = await adapter.requestDevice({
    requiredLimits: { maxBufferSize, maxTextureDimension2D },
  }).catch((error: unknown) => {
    throw new Problem("The graphics adapter could not be opened.", String(error), BROWSERS);
  });
  device.lost.then((info) => {
    if (info.reason !== "destroyed") {
      onLost(new Problem("The connection to the graphics adapter was lost.", info.message,
        "Reload the page; if it happens again, choose a lower level or a smaller window."));
    }
  }, () => undefined);
  const { vendor, architecture, description } = adapter.info;
  const words = description === "" ? `${vendor} ${architecture}`.trim() : description;
  return { device, name: words === "" ? "graphics adapter" : words };
}

/** Errors of validation and memory that `encode` causes, as one problem. */
export async function guarded<Result>(device: GPUDevice, what: string, encode: () => Result | Promise<Result>
): Promise<Result> {
  device.pushErrorScope("out-of-memory");
  device.pushErrorScope("validation");
  let result: Result;
  try {
    result = await encode();
  } finally {
    const errors = await Promise.all([device.popErrorScope(), device.popErrorScope()]);
    const error = errors.find((each) => each !== null);
    if (error instanceof GPUOutOfMemoryError) {
      throw new Problem(`The graphics memory ran out while ${what}.`, error.message, "Close other pages, show slices or fewer cameras (a smaller aperture), or use a smaller file.");
    }
    if (error != null) {
      throw new Problem(`The graphics adapter refused ${what}.`, error.message);
    }
  }
  return result;
}
