/** What the canvas shows as a file. */

import { make } from "./controls";

/** The name for a picture of a model: the model's, but for its ending. */
export function pictureName(file: string): string {
  const stem = file.split(/[/\\]/).pop()!.replace(/\.hmk$/i, "");
  return `${stem === "" ? "hmkcta" : stem}.png`;
}

/** Save what the canvas shows as a PNG file, named after the model's. */
export function savePicture(canvas: HTMLCanvasElement, file: string): void {
  canvas.toBlob((blob) => {
    if (blob !== null) {
      const link = make("a", { href: URL.createObjectURL(blob), download: pictureName(file) });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    }
  });
}
