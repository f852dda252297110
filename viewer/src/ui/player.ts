/** Playing time. */

import type { App } from "../app";
import { frameOf, framesOf, showFrame } from "../places";

const FRAMES_A_SECOND = 8;

export class Player {
  private timer = 0;

  constructor(private readonly app: App, private readonly refresh: () => void, signal: AbortSignal) {
    signal.addEventListener("abort", () => this.stop());
  }

  get playing(): boolean {
    return this.timer !== 0;
  }

  /** Play or stop; where there is but one frame, nothing plays. */
  toggle(): void {
    if (this.playing) {
      this.stop();
    } else if (this.frames > 1) {
      this.timer = window.setInterval(() => this.step(), 1000 / FRAMES_A_SECOND);
    }
    this.refresh();
  }

  private get frames(): number {
    return framesOf(this.app.metadata.axes, this.app.kind, this.app.state);
  }

  private stop(): void {
    clearInterval(this.timer);
    this.timer = 0;
  }

  private step(): void {
    const { app, frames } = this;
    if (frames < 2) {
      this.stop(); // the picture shows all of time by now
    } else if (!app.decoding) { // a step that is not decoded yet would never be seen
      const { axes } = app.metadata;
      showFrame(axes, app.kind, app.state, (Math.floor(frameOf(axes, app.kind, app.state)) + 1) % frames);
      app.redraw();
    }
    this.refresh();
  }
}
