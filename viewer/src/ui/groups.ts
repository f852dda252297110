/** What the panels of all kinds have in common: how a control changes the state, and groups that all of them show. */

import type { App } from "../app";
import type { FileKind } from "../reader/metadata";
import { COLOURS } from "../render/colours";
import { windowBounds } from "../render/window";
import { CURVES, type State } from "../state";
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

  /** Do something to the state, and draw. */
  protected change<Value>(act: (value: Value) => void): (value: Value) => void {
    return (value) => {
      act(value);
      this.app.redraw();
    };
  }

  protected changed(): void {
    this.refresh();
    this.app.redraw();
  }

  protected angle(label: string, min: number, max: number, get: () => number, set: (value: number) => void): Control {
    const wrapped = (): number => (max === 180 ? ((((get() + 180) % 360) + 360) % 360) - 180 : get());
    return slider(label, { min, max, step: 1, get: wrapped, set: this.change(set), show: (value) => `${Math.round(value)}°` });
  }

  protected colourMap(get: () => string, set: (name: string) => void): Control {
    return choice("Colours", Object.keys(COLOURS).map((name) => [name, name[0]!.toUpperCase() + name.slice(1)] as const),
      get, (name) => {
        set(name);
        this.changed();
      });
  }

  /** Sliders for the values at both ends of the colours; any other value can be typed. */
  protected window(get: () => { low: number; high: number }): Control[] {
    const { app } = this;
    const end = (label: string, key: "low" | "high"): Control => {
      const set = this.change((value: number) => {
        app.windowTouched = true;
        get()[key] = value;
      });
      return slider(label, {
        min: 0, max: 1, step: 0.0025, typed: { get: () => get()[key], set },
        get: () => {
          const [from, to] = windowBounds(app.range);
          return (get()[key] - from) / (to - from);
        },
        set: (share) => {
          const [from, to] = windowBounds(app.range);
          set(from + share * (to - from));
        },
      });
    };
    return [end("Low", "low"), end("High", "high")];
  }

  protected time(): Control {
    const { axes } = this.app.metadata;
    const n = axes.findIndex((axis) => axis.role === "time");
    const last = Math.max(1, (axes[n]?.size ?? 1) - 1);
    return group("Time", [
      slider("Frame", {
        min: 0, max: last, step: this.app.kind === "svbrdf" ? 1 : 0.05, get: () => this.state.time,
        show: (value) => `${value.toFixed(this.app.kind === "svbrdf" ? 0 : 1)} / ${last}`, set: this.change((value) => {
          this.state.time = value;
        }),
      }),
      this.play(),
    ], () => (axes[n]?.size ?? 1) > 1);
  }

  protected play(): Control {
    const { player } = this.services;
    return buttons({ label: "Play", pressed: () => player.playing, act: () => player.toggle() });
  }

  protected tone(): Control {
    const { tone } = this.state;
    return group("Tone", [
      slider("Exposure", {
        min: -6, max: 6, step: 0.1, get: () => tone.stops, show: (value) => `${value.toFixed(1)} EV`, set: this.change((value) => {
          tone.stops = value;
        }),
      }),
      choice("Curve", CURVES.map((curve) => [curve, curve[0]!.toUpperCase() + curve.slice(1)] as const), () => tone.curve,
        this.change((curve) => {
          tone.curve = curve;
        })),
    ]);
  }

  protected view(): Control {
    const kinds = this.app.kinds();
    return group("View", [
      only(() => kinds.length > 1, choice("Show as", kinds.map((kind) => [kind, KINDS[kind]] as const), () => this.app.kind,
        (kind) => void this.app.showAs(kind).then(() => this.app.closed || this.build(), (error) => this.app.fail(error)))),
      buttons({
        label: "Reset view", act: () => {
          this.app.resetView();
          this.changed();
        },
      }, { label: "Save picture", act: () => this.services.save() }),
    ]);
  }

  protected keys(): Control {
    const rows = Object.entries(KEYS).map(([keys, does]) => make("tr", {},
      make("td", {}, ...keys.split(" ").flatMap((key) => [make("kbd", {}, key), " "])), make("td", {}, does)));
    const details = make("details", { id: "keys" }, make("summary", {}, "Mouse, touch and keys"),
      make("p", { class: "note" }, "Drag: turn or move. Right button, Shift or two fingers: move the light. "
        + "Wheel or pinch: nearer, farther. Pointing at a slice reads its value."),
      make("table", {}, make("tbody", {}, ...rows)));
    return { element: make("section", {}, details), refresh: () => undefined };
  }
}
