/** The panel: which controls there are for a model, and what they change. */

import type { App } from "../app";
import { headline } from "../figures";
import { framesOf, resetView } from "../places";
import type { FileKind } from "../reader/metadata";
import { findCameras } from "../render/lightfield";
import { layOut } from "../render/layout";
import { colourAxis } from "../render/slices";
import { LEAST_GAIN, MOST_GAIN } from "../render/window";
import { MOST_LIGHTS, type State, VOLUME_MODES, newLight } from "../state";
import { type Control, buttons, check, choice, colour, group, make, only, plain, slider, tell } from "./controls";
import { Groups, type Services } from "./groups";
import { transferEditor } from "./transfer";

/** Builds the controls of an app into an element; `refresh` shows the state anew. */
export class Panel extends Groups {
  private controls: Control[] = [];
  private built: FileKind | null = null; // the kind that they are for

  constructor(app: App, private readonly element: HTMLElement, services: Services) {
    super(app, services);
    this.build();
  }

  override build(): void {
    const { app } = this;
    const { kind } = app;
    this.built = kind;
    this.controls = [
      this.levels(), this.compare(),
      ...(kind === "svbrdf" ? this.material() : kind === "lightfield" ? this.lightfield() : kind === "volume" ? this.volume() : this.slices()),
      this.axes(), this.tone(), this.view(), this.keys(),
    ];
    this.element.replaceChildren(...this.controls.map((control) => control.element));
    this.refresh();
  }

  override refresh(): void {
    if (this.built !== this.app.kind) {
      this.build();
      return;
    }
    this.controls.forEach((control) => control.refresh());
  }

  private levels(): Control {
    const { length } = this.app.metadata.levels;
    const [snr, of] = [make("span"), make("small")];
    const level = slider("Level", {
      min: 1, max: length, step: 1, get: () => this.state.level, show: (value) => `${value} of ${length}`,
      set: this.change((state, value) => {
        state.level = value;
      }),
    });
    return group("Level", [{
      element: make("p", { class: "big" }, snr, " ", of), refresh: () => {
        headline(this.app.shown).forEach((text, n) => tell([snr, of][n]!, text));
      },
    }, only(() => length > 1, level)]);
  }

  private compare(): Control {
    const { app } = this;
    const { levels } = app.metadata;
    const compare = (): State["compare"] => this.state.compare;
    const others = [["original", "Original"], ...levels.map((_, l) => [String(l + 1), `Level ${l + 1}`])] as [string, string][];
    return group("Compare", [
      choice("Show", [["none", "This level"], ["split", "Side by side"], ["heat", "Error"]], () => compare().mode, this.change((state, mode) => {
        state.compare.mode = mode;
      })),
      only(() => compare().mode !== "none", choice("With", others, () => (compare().level === null ? "original" : String(compare().level)),
        this.change((state, value) => {
          state.compare.level = value === "original" ? null : Number(value);
        }), (value) => (value === "original" ? app.shown.original : Number(value) <= app.shown.arrived))),
      only(() => compare().mode === "split", slider("Divider", {
        min: 0, max: 1, step: 0.01, get: () => compare().position, show: (value) => `${Math.round(100 * value)} %`,
        set: this.change((state, value) => {
          state.compare.position = value;
        }),
      })),
      only(() => compare().mode === "heat", slider("Amplify", {
        min: LEAST_GAIN, max: MOST_GAIN, step: 1, get: () => Math.log2(compare().gain), show: (value) => `x ${plain(2 ** value)}`,
        set: this.change((state, value) => {
          state.own.gain = false;
          state.compare.gain = 2 ** value;
        }),
      })),
      only(() => compare().mode === "heat", this.own("gain", "As the file's error needs")),
    ], () => levels.length > 1 || app.shown.original);
  }

  private material(): Control[] {
    const surface = (): State["surface"] => this.state.surface;
    return [group("Object", [
      choice("Shape", [["sphere", "Sphere"], ["plane", "Plane"], ["cloth", "Cloth"], ["mesh", "Mesh (open one first)"]],
        () => surface().shape, this.change((state, shape) => {
          state.surface.shape = shape;
          resetView(state, this.app.metadata.axes, this.app.kind);
        }), (shape) => shape !== "mesh" || this.app.shown.mesh),
      slider("Repeats", {
        min: 0, max: 3, step: 0.5, get: () => Math.log2(surface().repeat), show: (value) => `x ${plain(2 ** value)}`,
        set: this.change((state, value) => {
          state.surface.repeat = 2 ** value;
        }),
      }),
      check("Directions' y runs against the rows", () => surface().yUp, this.change((state, value) => {
        state.surface.yUp = value;
      })),
      check("Values lack the cosine", () => !surface().cosine, this.change((state, value) => {
        state.surface.cosine = !value;
      })),
      check("Values are sRGB-coded", () => surface().coded, this.change((state, value) => {
        state.own.coded = false;
        state.surface.coded = value;
      })),
    ]), this.lights(), this.time()];
  }

  private lights(): Control {
    const light = (state = this.state): State["lights"][number] => state.lights[state.light]!;
    return group("Light", [
      only(() => this.state.lights.length > 1, this.lightChoice()),
      choice("Kind", [["sun", "Directional"], ["point", "Point"]], () => (light().point ? "point" : "sun"), this.change((state, value) => {
        const point = value === "point";
        Object.assign(light(state), { point, intensity: point ? light(state).distance ** 2 : 1 });
      })),
      ...this.towards(light),
      only(() => light().point, slider("Distance", {
        min: 1.05, max: 10, step: 0.05, get: () => light().distance, set: this.change((state, value) => {
          light(state).distance = value;
        }),
      })),
      slider("Intensity", {
        min: -4, max: 6, step: 0.1, get: () => Math.log2(light().intensity), show: (value) => plain(2 ** value),
        set: this.change((state, value) => {
          light(state).intensity = 2 ** value;
        }),
      }),
      colour("Colour", () => light().colour, this.change((state, value) => {
        light(state).colour = value;
      })),
      this.lightCount(),
    ]);
  }

  /** Which of the lights the other controls show; options of lights that there are not are hidden. */
  private lightChoice(): Control {
    const select = choice("Light", Array.from({ length: MOST_LIGHTS }, (_, n) => [String(n), `Light ${n + 1}`] as const),
      () => String(this.state.light), this.change((state, value) => {
        state.light = Number(value);
      }), (value) => Number(value) < this.state.lights.length);
    const options = select.element.querySelectorAll("option");
    return {
      element: select.element, refresh: () => {
        select.refresh();
        options.forEach((option) => {
          option.hidden = option.disabled;
        });
      },
    };
  }

  private lightCount(): Control {
    const count = (): number => this.state.lights.length;
    return buttons({
      label: "Add a light", enabled: () => count() < MOST_LIGHTS, act: () => this.app.choose((state) => {
        state.light = state.lights.push(newLight(state.lights[state.light]!.azimuth + 120, 40)) - 1;
      }),
    }, {
      label: "Remove", enabled: () => count() > 1, act: () => this.app.choose((state) => {
        state.lights.splice(state.light, 1);
      }),
    });
  }

  /** Sliders for where a light comes from. */
  private towards(light: (state?: State) => State["lights"][number]): Control[] {
    return [
      this.angle("Azimuth", 180, () => light().azimuth, (state, value) => {
        light(state).azimuth = value;
      }),
      this.angle("Elevation", 90, () => light().elevation, (state, value) => {
        light(state).elevation = value;
      }),
    ];
  }

  private lightfield(): Control[] {
    const { axes } = this.app.metadata;
    const { last } = findCameras(axes, layOut(axes, "lightfield"));
    const along = (label: string, most: number, key: "row" | "column"): Control => only(() => most > 0, slider(label, {
      min: 0, max: most, step: 0.01, get: () => this.state.view[key], show: (value) => value.toFixed(2), set: this.change((state, value) => {
        state.view[key] = value;
      }),
    }));
    return [group("View point", [
      along("Row", last[0], "row"), along("Column", last[1], "column"),
      slider("Focus", {
        min: -8, max: 8, step: 0.05, get: () => this.state.view.focus, show: (value) => `${value.toFixed(2)} px`,
        set: this.change((state, value) => {
          state.view.focus = value;
        }),
      }),
      slider("Aperture", {
        min: 0, max: Math.max(1, Math.hypot(...last)), step: 0.1, get: () => this.state.view.aperture,
        set: this.change((state, value) => {
          state.view.aperture = value;
        }),
      }),
    ]), this.time()];
  }

  private volume(): Control[] {
    const volume = (): State["volume"] => this.state.volume;
    const iso = (): boolean => volume().mode === "iso";
    const names = { emission: "Glow", shaded: "Shaded", iso: "Iso-surface", maximum: "Brightest on the ray" };
    return [group("Look", [
      choice("Mode", VOLUME_MODES.map((mode) => [mode, names[mode]] as const), () => volume().mode, this.change((state, mode) => {
        state.volume.mode = mode;
      })),
      this.colourMap("volume"),
      only(() => !iso() && volume().mode !== "maximum", transferEditor(() => volume().opacity, this.change((state, points) => {
        state.volume.opacity = points;
      }), () => volume().colours)),
      only(iso, slider("Iso value", {
        min: 0, max: 1, step: 0.005, get: () => volume().iso, show: (value) => plain(volume().low + value * (volume().high - volume().low)),
        set: this.change((state, value) => {
          state.volume.iso = value;
        }),
      })),
      ...this.window("volume"),
      slider("Step", {
        min: 0.25, max: 2, step: 0.25, get: () => volume().step, show: (value) => `${value} voxel`, set: this.change((state, value) => {
          state.volume.step = value;
        }),
      }),
      this.clips(),
    ]), group("Light", this.towards((state = this.state) => state.lights[0]!), () => volume().mode === "shaded" || iso()), this.time()];
  }

  /** Where the box begins and ends, folded away. */
  private clips(): Control {
    const clip = (name: string, axis: number, key: "clipLow" | "clipHigh"): Control => slider(name, {
      min: 0, max: 1, step: 0.01, get: () => this.state.volume[key][axis]!, show: (value) => `${Math.round(100 * value)} %`,
      set: this.change(({ volume }, value) => {
        const other = volume[key === "clipLow" ? "clipHigh" : "clipLow"][axis]!;
        volume[key][axis] = key === "clipLow" ? Math.min(value, other - 0.01) : Math.max(value, other + 0.01);
      }),
    });
    const clips = (["x", "y", "z"] as const).flatMap((name, axis) =>
      [clip(`${name} from`, axis, "clipLow"), clip(`${name} to`, axis, "clipHigh")]);
    const details = make("details", {}, make("summary", {}, "Clip"), ...clips.map((control) => control.element));
    return { element: details, refresh: () => clips.forEach((control) => control.refresh()) };
  }

  private slices(): Control[] {
    const { axes } = this.app.metadata;
    const names = axes.map((axis, n) => [String(n), axis.name] as const);
    const pick = (label: string, key: "x" | "y"): Control => choice(label, names, () => String(this.state.slice[key]), this.change((state, value) => {
      const { slice } = state;
      const other = key === "x" ? "y" : "x";
      if (slice[other] === Number(value)) {
        slice[other] = slice[key];
      }
      slice[key] = Number(value);
      state.pan = [0, 0];
    }));
    const channels = axes.some((axis) => axis.role === "channel" && axis.size > 2);
    return [group("Picture", [
      ...(axes.length > 1 ? [pick("Across", "x"), pick("Down", "y")] : []),
      only(() => channels, check("Channels as colours", () => this.state.slice.colour, this.change((state, value) => {
        state.slice.colour = value;
      }))),
      only(() => colourAxis(this.app.metadata, this.state) === null, this.colourMap("slice")),
      ...this.window("slice"),
    ])];
  }

  /** Where the axes stand that nothing else moves along. */
  private axes(): Control {
    const { metadata, kind } = this.app;
    const moved = this.movedAxes();
    const stands = (n: number): boolean => metadata.axes[n]!.size > 1 && !moved.includes(n)
      && (kind !== "generic" || ![this.state.slice.x, this.state.slice.y, colourAxis(metadata, this.state)].includes(n));
    const sliders = metadata.axes.map((axis, n) => only(
      () => stands(n),
      slider(axis.name, {
        min: 0, max: axis.size - 1, step: 1, get: () => this.state.position[n]!, show: (value) => `${value} / ${axis.size - 1}`,
        set: this.change((state, value) => {
          state.position[n] = value;
        }),
      })));
    const playing = only(() => kind === "generic" && framesOf(metadata.axes, kind, this.state) > 1, this.play());
    return group(kind === "generic" ? "Other axes" : "Further axes", [...sliders, playing], () => metadata.axes.some((_, n) => stands(n)));
  }

  /** Axes that the renderer of the kind moves along. */
  private movedAxes(): number[] {
    const { metadata, kind } = this.app;
    if (kind === "generic") {
      return [];
    }
    const { space, views, lights, time, channel, channels } = layOut(metadata.axes, kind);
    return [...space, ...views, ...lights, time, channels.length > 1 ? channel : null].filter((n) => n !== null);
  }
}
