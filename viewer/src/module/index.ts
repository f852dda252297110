/** What a page or program of one's own decodes files with: the module `hmkcta.js` (docs/web.md). */

import { load } from "../load";
import { Problem } from "../problem";
import { DEFAULT_LIMITS, type Limits } from "../reader/limits";
import { HmkError } from "../reader/reasons";
import { BlobSource, type ByteSource, fileUrl, openUrl } from "../stream";
import { Model } from "./model";
import { shown } from "./shown";

export { HmkError, Model, Problem };
export type { Index, Slice } from "./model";
export type { OnGpu } from "./onGpu";
export type { Limits };

/** What is told of a level as soon as its numbers are there; the next one waits for what it returns. */
export type LevelListener = (model: Model, level: number) => void | Promise<void>;

/**
 * Read a file from its address, or one that is at hand, and check it on the way. Of files that are trusted `limits` may
 * let pass more than usual (docs/format.md, part II).
 *
 * Throws an `HmkError` of a file that is damaged, incomplete, newer or no `.hmk` file (its `reason` is of docs/format.md,
 * section 8), a `Problem` where it could not be fetched or `source` is nothing to read.
 */
export async function open(
  source: string | URL | Blob | BufferSource, onLevel: LevelListener = () => undefined, limits: Partial<Limits> = {},
): Promise<Model> {
  let model: Model | null = null;
  const reading = await load(await byteSource(source), {
    onStart: () => undefined,
    onLevel: (read, level) => {
      model ??= new Model(read);
      model.arrived = level;
      return onLevel(model, level);
    },
  }, { ...DEFAULT_LIMITS, ...limits });
  return model ?? new Model(reading);
}

function byteSource(source: string | URL | Blob | BufferSource): ByteSource | Promise<ByteSource> {
  if (typeof source === "string" || source instanceof URL) {
    const base = typeof document === "object" ? document.baseURI : typeof location === "object" ? location.href : undefined;
    return openUrl(fileUrl(String(source), base));
  }
  if (!isBytes(source)) {
    throw new Problem(`source: found ${shown(source)}, allowed an address, a Blob, File, ArrayBuffer or typed array.`);
  }
  return new BlobSource(source instanceof File ? source : new File([source], "the file"));
}

/** Whether somebody's program gave what its types promise; objects of another frame are no instances of this one's. */
function isBytes(source: unknown): boolean {
  return ArrayBuffer.isView(source) || ["[object Blob]", "[object File]", "[object ArrayBuffer]"].includes(Object.prototype.toString.call(source));
}
