/** Files that are dropped on the page or chosen on it. */

import { readGltf } from "../render/gltf";
import { type MeshMaker, meshOf, parseObj } from "../render/mesh";
import { byId } from "./controls";

export function listenForFiles(take: (file: File) => void): void {
  const takeFirst = (files: FileList | null | undefined): void => {
    const file = files?.[0];
    if (file !== undefined) {
      take(file);
    }
  };
  const chooser = byId<HTMLInputElement>("chooser");
  for (const id of ["choose", "open"]) {
    byId(id).addEventListener("click", () => chooser.click());
  }
  chooser.addEventListener("change", () => {
    takeFirst(chooser.files);
    chooser.value = ""; // to be told when the same file is chosen again
  });
  const drop = byId("drop");
  window.addEventListener("dragover", (event) => {
    event.preventDefault();
    drop.hidden = false;
  });
  window.addEventListener("dragleave", (event) => {
    drop.hidden = event.relatedTarget === null;
  });
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    drop.hidden = true;
    takeFirst(event.dataTransfer?.files);
  });
}

export function isMesh(file: File): boolean {
  return /\.(obj|glb|gltf)$/i.test(file.name);
}

/** What makes the mesh in a file, for a number of repeats. */
export async function meshIn(file: File): Promise<MeshMaker> {
  if (/\.obj$/i.test(file.name)) {
    const text = await file.text();
    return (repeat) => parseObj(text, repeat);
  }
  const corners = readGltf(new Uint8Array(await file.arrayBuffer()));
  return (repeat) => meshOf(corners, repeat);
}
