/** What the panels of all kinds have in common: how a control changes the state, and groups that all of them show. */

import type { App } from "../app";
import type { FileKind } from "../reader/metadata";
import { COLOURS } from "../render/colours";
import { kindsOf } from "../render/kinds";
import { whiteOf } from "../render/white";
import { windowBounds } from "../render/window";
import { CURVES, MOST_STOPS, type State } from "../state";
import { type Control, buttons, choice, group, make, only, slider } from "./controls";
import { KEYS } from "./keys";
import type { Player } from "./player";

const KINDS: Record<FileKind, string> = {
  svbrdf: "Material", lightfield: "Light field", volume: "Volume", generic: "Slices",
};

/** What the page around does for the controls. */
export interface Services {
  player: Player;
  save(): void;
}

export abstract class Groups {
  constructor(protected readonly app: App, protected readonly services: Services) {}

  /** Make all controls anew. */
  abstract build(): void;

  /** Show the state anew. */
  abstract refresh(): void;

  protected get state(): State {
    return this.app.state;
  }

  /** What a control does to what is chosen. */
  protected change<Value>(act: (state: State, value: Value) => void): (value: Value) => void {
    return (value) => this.app.choose((state) => act(state, value));
  }

  protected angle(label: string, max: 90 | 180, get: () => number, set: (state: State, value: number) => void): Control {
    const wrapped = (): number => (max === 180 ? ((((get() + 180) % 360) + 360) % 360) - 180 : get());
    return slider(label, { min: -max, max, step: 1, get: wrapped, set: this.change(set), show: (value) => `${Math.round(value)}°` });
  }

  protected colourMap(of: "slice" | "volume"): Control {
    return choice("Colours", Object.keys(COLOURS).map((name) => [name, name[0]!.toUpperCase() + name.slice(1)] as const),
      () => this.state[of].colours, this.change((state, name) => {
        state[of].colours = name;
      }));
  }

  /** A slider over the values that were seen; any other value can be typed. */
  private value(label: string, get: () => number, choose: (state: State, value: number) => void, least = -Infinity): Control {
    const { sourceDtype, axes } = this.app.metadata;
    const bounds = (): [number, number] => {
      const [from, to] = windowBounds(this.app.shown.range ?? { low: 0, high: 1, least: 0, most: 1 }, whiteOf(sourceDtype, this.app.kind, axes));
      return [Math.max(least, from), Math.max(least + 1e-6, to)];
    };
    const set = this.change(choose);
    return slider(label, {
      min: 0, max: 1, step: 0.0025, typed: { get, set },
      get: () => {
        const [from, to] = bounds();
        return (get() - from) / (to - from);
      },
      set: (share) => {
        const [from, to] = bounds();
        set(from + share * (to - from));
      },
    });
  }

  /** The values at both ends of the colours, and a button for the file's own ones. */
  protected window(of: "slice" | "volume"): Control[] {
    const end = (label: string, key: "low" | "high"): Control => this.value(label, () => this.state[of][key], (state, value) => {
      state.own[of] = false;
      state[of][key] = value;
    });
    return [end("Low", "low"), end("High", "high"), this.own(of, "Window of the file")];
  }

  /** The value that shows as white, of light fields and materials. */
  protected white(): Control[] {
    return [this.value("White", () => this.state.tone.white, (state, value) => {
      state.own.white = value <= 0; // nothing is darker than black
      state.tone.white = value;
    }, 0), this.own("white", "White of the file")];
  }

  /** Takes back what was chosen by hand. */
  protected own(of: keyof State["own"], label: string): Control {
    return only(() => !this.state.own[of], buttons({ label, act: () => this.app.choose((state) => {
      state.own[of] = true;
    }) }));
  }

  protected time(): Control {
    const { axes } = this.app.metadata;
    const n = axes.findIndex((axis) => axis.role === "time");
    const last = Math.max(1, (axes[n]?.size ?? 1) - 1);
    const whole = this.app.kind === "svbrdf";
    return group("Time", [
      slider("Frame", {
        min: 0, max: last, step: whole ? 1 : 0.05, get: () => this.state.time, show: (value) => `${value.toFixed(whole ? 0 : 1)} / ${last}`,
        set: this.change((state, value) => {
          state.time = value;
        }),
      }),
      this.play(),
    ], () => (axes[n]?.size ?? 1) > 1);
  }

  protected play(): Control {
    return buttons({ label: () => (this.app.shown.playing ? "Pause" : "Play"), act: () => this.services.player.toggle() });
  }

  protected tone(): Control {
    const { kind } = this.app;
    return group("Tone", [
      ...(kind === "svbrdf" || kind === "lightfield" ? this.white() : []),
      slider("Exposure", {
        min: -MOST_STOPS, max: MOST_STOPS, step: 0.1, get: () => this.state.tone.stops, show: (value) => `${value.toFixed(1)} EV`,
        set: this.change((state, value) => {
          state.tone.stops = value;
        }),
      }),
      choice("Curve", CURVES.map((curve) => [curve, curve[0]!.toUpperCase() + curve.slice(1)] as const), () => this.state.tone.curve,
        this.change((state, curve) => {
          state.tone.curve = curve;
        })),
    ]);
  }

  protected view(): Control {
    const kinds = kindsOf(this.app.metadata);
    return group("View", [
      only(() => kinds.length > 1, choice("Show as", kinds.map((kind) => [kind, KINDS[kind]] as const), () => this.app.kind,
        (kind) => void this.app.showAs(kind).catch((error) => this.app.fail(error)))),
      buttons({ label: "Reset view", act: () => this.app.resetView() }, { label: "Save picture", act: () => this.services.save() }),
    ]);
  }

  protected keys(): Control {
    const rows = Object.entries(KEYS).map(([keys, does]) => make("tr", {},
      make("td", {}, ...keys.split(" ").flatMap((key) => [make("kbd", {}, key), " "])), make("td", {}, does)));
    const details = make("details", { id: "keys" }, make("summary", {}, "Mouse, touch and keys"),
      make("p", { class: "note" }, "Drag: turn or move. Right button, Shift or two fingers: move the light. "
        + "Wheel or pinch: nearer, farther. Pointing at a slice, touching it, or moving it by arrow keys reads a value."),
      make("table", {}, make("tbody", {}, ...rows)));
    return { element: make("section", {}, details), refresh: () => undefined };
  }
}
