/** What is shown as a file. */

import type { App } from "../app";
import { pictureName } from "../figures";
import { make } from "./controls";

/** Save what is chosen, at its full size once it is whole, as a PNG file, named after the model and what of it is shown. */
export async function savePicture(app: App): Promise<void> {
  const name = pictureName(app.shown);
  const image = await app.picture();
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d")!.putImageData(image, 0, 0);
  const link = make("a", { href: URL.createObjectURL(await canvas.convertToBlob()), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
