/** What a page or program of one's own decodes files with: the module `hmkcta.js` (docs/web.md). */

import { load } from "../load";
import { Problem } from "../problem";
import { HmkError } from "../reader/reasons";
import { BlobSource, type ByteSource, fileUrl, openUrl } from "../stream";
import { Model } from "./model";

export { HmkError, Model, Problem };
export type { Index, Slice } from "./model";
export type { OnGpu } from "./onGpu";

/** What is told of a level as soon as its numbers are there; the next one waits for what it returns. */
export type LevelListener = (model: Model, level: number) => void | Promise<void>;

/**
 * Read a file from its address, or one that is at hand, and check it on the way.
 *
 * Throws an `HmkError` of a file that is damaged, incomplete or newer (its `reason` is of docs/format.md, section 8), a
 * `Problem` where it could not be fetched.
 */
export async function open(source: string | URL | Blob | BufferSource, onLevel: LevelListener = () => undefined): Promise<Model> {
  let model: Model | null = null;
  const reading = await load(await byteSource(source), {
    onTables: () => undefined,
    onLevel: (read, level) => {
      model ??= new Model(read);
      model.arrived = level;
      return onLevel(model, level);
    },
  });
  return model ?? new Model(reading);
}

function byteSource(source: string | URL | Blob | BufferSource): ByteSource | Promise<ByteSource> {
  if (typeof source === "string" || source instanceof URL) {
    const base = typeof document === "object" ? document.baseURI : typeof location === "object" ? location.href : undefined;
    return openUrl(fileUrl(String(source), base));
  }
  return new BlobSource(source instanceof File ? source : new File([source], "the file"));
}
