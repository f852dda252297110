/** How far a file has come, and what its frames take: a bar in the panel and a line in the picture's corner. */

import { formatBytes } from "../bytes";
import { badge } from "../figures";
import type { Shown } from "../store";
import { byId, tell } from "./controls";

const QUIET = 1000; // milliseconds without progress on the page: each change of it is painted, by the adapter that decodes

export class Status {
  private bytes: [number, number] = [0, 0];
  private last: Shown | null = null;
  private quiet = true;
  private hush = 0; // the timer that ends it

  constructor(private readonly adapter: () => string) {}

  /** Be quiet about a new file for a while, after which `speak` is called. */
  begin(speak: () => void): void {
    this.last = null;
    this.quiet = true;
    clearTimeout(this.hush);
    this.hush = window.setTimeout(speak, QUIET);
  }

  /** Say from now on what there is to say. */
  speak(): void {
    clearTimeout(this.hush);
    this.quiet = false;
    this.progress(...this.bytes);
  }

  progress(have: number, size: number): void {
    this.bytes = [have, size];
    if (this.quiet) {
      return;
    }
    const bar = byId("progress");
    const percent = size === 0 ? 100 : Math.floor((100 * have) / size);
    bar.hidden = have >= size;
    bar.setAttribute("aria-valuenow", String(percent));
    (bar.firstElementChild as HTMLElement).style.width = `${percent}%`;
    this.say();
  }

  /** What is shown, and at once where the picture is not yet what is chosen. */
  show(shown: Shown): void {
    const text = badge(shown);
    this.last = shown;
    tell(byId("decoding"), text ?? "");
    byId("decoding").hidden = text === null;
    this.say();
  }

  /** Nothing more comes. */
  endProgress(): void {
    byId("progress").hidden = true;
  }

  /** Say nothing: there is no file. */
  clear(): void {
    this.endProgress();
    byId("statistics").textContent = byId("decoding").textContent = "";
    byId("decoding").hidden = true;
  }

  private say(): void {
    if (this.quiet) {
      return;
    }
    const [have, size] = this.bytes;
    const bytes = have < size ? `${formatBytes(have)} of ${formatBytes(size)}` : formatBytes(size);
    const { drawn = null, share = 1 } = this.last ?? {};
    tell(byId("statistics"), drawn === null ? bytes
      : [`${drawn.milliseconds.toFixed(1)} ms`, `${drawn.width} x ${drawn.height}`, bytes, ...(share < 1 ? ["decoding"] : []),
        this.adapter()].join("  ·  "));
  }
}
