/** How large frames are drawn, and how much is decoded in each, so that none takes long. */

import { type Cost, measured, predicted } from "./cost";

const MOVING = 45; // milliseconds that a frame may take while something moves
const STILL = 1000; // and when nothing does: longer ones are stopped by some systems
const DECODE = 120; // milliseconds of decoding a frame
const SCALES = [1, 0.7, 0.5, 0.35, 0.25, 0.18, 0.125];

export class Pace {
  private cost: Cost | null = null;
  private warm = false; // the first frame of a shader waits for the driver to compile it, and says nothing of its cost
  budget = 1 << 11; // elements decoded a frame

  constructor(
    private readonly canvas: HTMLCanvasElement, private readonly most: number, readonly fixedSize: [number, number] | null,
  ) {}

  /** Another renderer draws from now on. */
  reset(): void {
    this.cost = null;
    this.warm = false;
  }

  /** Learn from a frame; returns whether there is reason to draw another one. */
  learn(pixels: number, milliseconds: number, decoded: number): boolean {
    if (!this.warm) {
      this.warm = true;
      return this.fixedSize === null || decoded > 0;
    }
    if (decoded === 0) {
      this.cost = measured(this.cost, pixels, milliseconds);
      return false;
    }
    const decoding = milliseconds - (this.cost === null ? 0 : predicted(this.cost, pixels));
    const faster = decoding < DECODE / 4 ? 4 : decoding < DECODE / 2 ? 2 : decoding > DECODE ? 0.5 : 1;
    this.budget = Math.max(256, Math.min(1 << 26, this.budget * faster));
    return true;
  }

  /** Pixels of the page. */
  get full(): [number, number] {
    const density = Math.min(window.devicePixelRatio, 2);
    const side = (length: number): number => Math.max(8, Math.min(this.most, Math.round(length * density)));
    return this.fixedSize ?? [side(this.canvas.clientWidth), side(this.canvas.clientHeight)];
  }

  /** Pixels of a frame: all of them, fewer where they would take too long. */
  size(moving: boolean): [number, number] {
    if (this.fixedSize !== null) {
      return this.fixedSize;
    }
    const { full } = this;
    const allowed = moving ? MOVING : STILL;
    const { cost } = this;
    const scale = SCALES.find((each) => cost !== null && predicted(cost, each * each * full[0] * full[1]) <= allowed)
      ?? SCALES.at(-1)!;
    return [Math.max(8, Math.round(full[0] * scale)), Math.max(8, Math.round(full[1] * scale))];
  }
}
