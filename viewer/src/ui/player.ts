/** Playing time: frame after frame, each of which is seen before the next one is chosen. */

import type { App } from "../app";
import { frameOf, framesOf, showFrame } from "../places";

const FRAMES_A_SECOND = 8;

export class Player {
  private timer = 0;

  constructor(private readonly app: App, signal: AbortSignal) {
    signal.addEventListener("abort", () => this.stop());
  }

  /** Play or pause; where there is but one frame, nothing plays. */
  toggle(): void {
    this.app.dispatch({ type: "play", playing: !this.app.shown.playing });
    this.stop();
    if (this.app.shown.playing) {
      this.timer = window.setInterval(() => this.step(), 1000 / FRAMES_A_SECOND);
    }
  }

  private stop(): void {
    clearInterval(this.timer);
    this.timer = 0;
  }

  private step(): void {
    const { kind, playing, drawn, state, metadata: { axes } } = this.app.shown;
    if (!playing) {
      this.stop(); // the picture shows all of time by now
    } else if (drawn?.whole === true && drawn.kind === kind && frameOf(axes, kind, drawn.state) === frameOf(axes, kind, state)) {
      this.app.choose((draft) => {
        showFrame(axes, kind, draft, (Math.floor(frameOf(axes, kind, draft)) + 1) % framesOf(axes, kind, draft));
      });
    }
  }
}
