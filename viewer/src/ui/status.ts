/** How far a file has come, and what its frames take: a bar in the panel and a line in the picture's corner. */

import type { Statistics } from "../app";
import { formatBytes } from "../bytes";
import { byId } from "./controls";

const QUIET = 1000; // milliseconds without progress on the page: each change of it is painted, by the adapter that decodes

export class Status {
  private bytes: [number, number] = [0, 0];
  private last: Statistics | null = null;
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

  frame(statistics: Statistics): void {
    this.last = statistics;
    this.say();
  }

  /** Nothing more comes. */
  endProgress(): void {
    byId("progress").hidden = true;
  }

  /** Say nothing: there is no file. */
  clear(): void {
    this.endProgress();
    byId("statistics").textContent = "";
  }

  private say(): void {
    if (this.quiet) {
      return;
    }
    const [have, size] = this.bytes;
    const bytes = have < size ? `${formatBytes(have)} of ${formatBytes(size)}` : formatBytes(size);
    const { last } = this;
    byId("statistics").textContent = last === null ? bytes
      : [`${last.milliseconds.toFixed(1)} ms`, `${last.width} x ${last.height}`, bytes, ...(last.decoding ? ["decoding"] : []),
        this.adapter()].join("  ·  ");
  }
}
