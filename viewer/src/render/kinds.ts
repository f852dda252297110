/** What a file can be shown as, and by which renderer. */

import type { Decoder } from "../gpu/decoder";
import type { FileKind, Metadata } from "../reader/metadata";
import type { State } from "../state";
import { layOut } from "./layout";
import { LightfieldRenderer } from "./lightfield";
import type { Renderer } from "./renderer";
import { SliceRenderer } from "./slices";
import { SvbrdfRenderer } from "./svbrdf";
import { VolumeRenderer } from "./volume";

/** The file's kind, if its axes make it, and slices. */
export function kindsOf({ kind, axes }: Metadata): FileKind[] {
  try {
    return kind === "generic" ? ["generic"] : (layOut(axes, kind), [kind, "generic"]);
  } catch {
    return ["generic"];
  }
}

/** The renderer of a kind; `first` is the state and the size of the first frame. */
export function makeRenderer(
  device: GPUDevice, kind: FileKind, metadata: Metadata, decoders: Decoder[], first: [State, number, number],
): Promise<Renderer> {
  switch (kind) {
    case "svbrdf": return SvbrdfRenderer.make(device, metadata, decoders, first);
    case "lightfield": return LightfieldRenderer.make(device, metadata, decoders);
    case "volume": return VolumeRenderer.make(device, metadata, decoders);
    default: return SliceRenderer.make(device, decoders);
  }
}
