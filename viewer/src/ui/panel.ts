/** The panel: which controls there are for a model, and what they change. */

import type { App } from "../app";
import { framesOf } from "../places";
import type { FileKind } from "../reader/metadata";
import { findCameras } from "../render/lightfield";
import { layOut } from "../render/layout";
import { colourAxis } from "../render/slices";
import { type State, VOLUME_MODES, newLight } from "../state";
import { type Control, buttons, check, choice, colour, group, make, only, plain, slider } from "./controls";
import { Groups, type Services } from "./groups";
import { transferEditor } from "./transfer";

const MOST_LIGHTS = 8;

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
    const { app } = this;
    const { quality, levels } = app.metadata;
    const decibels = (snr: number): string => (snr === Infinity ? "exact" : `${snr.toFixed(1)} dB`);
    const big = make("p", { class: "big" });
    const level = slider("Level", {
      min: 1, max: levels.length, step: 1, get: () => Math.min(this.state.level, Math.max(1, app.arrived)),
      show: (value) => `${value} of ${levels.length}`,
      set: this.change((value) => {
        this.state.level = Math.min(value, Math.max(1, app.arrived));
      }),
    });
    return group("Level", [{
      element: big, refresh: () => {
        const shown = Math.min(this.state.level, Math.max(1, app.arrived));
        const snr = decibels(quality[shown - 1]!.snrDb);
        big.replaceChildren(snr, make("small", {}, levels.length === 1 ? " SNR, one level" : ` SNR at level ${shown} of ${levels.length}`));
      },
    }, only(() => levels.length > 1, level)]);
  }

  private compare(): Control {
    const { app } = this;
    const several = app.metadata.levels.length > 1;
    const others = (): [string, string][] => [
      ...(app.original === null ? [] : [["original", "Original"] as [string, string]]),
      ...app.metadata.levels.map((_, l): [string, string] => [String(l + 1), `Level ${l + 1}`]),
    ];
    const { compare } = this.state;
    if (app.original === null && compare.level === null) {
      compare.level = 1;
    }
    const active = (): boolean => this.state.compare.mode !== "none";
    return group("Compare", [
      choice("Show", [["none", "This level"], ["split", "Side by side"], ["heat", "Error"]], () => compare.mode, (mode) => {
        compare.mode = mode;
        this.changed();
      }),
      only(active, choice("With", others(), () => (compare.level === null ? "original" : String(compare.level)), (value) => {
        compare.level = value === "original" ? null : Number(value);
        this.changed();
      })),
      only(() => compare.mode === "split", slider("Divider", {
        min: 0, max: 1, step: 0.01, get: () => compare.position, show: (value) => `${Math.round(100 * value)} %`,
        set: this.change((value) => {
          compare.position = value;
        }),
      })),
      only(() => compare.mode === "heat", slider("Amplify", {
        min: -2, max: 12, step: 1, get: () => Math.log2(compare.gain), show: (value) => `x ${plain(2 ** value)}`,
        set: this.change((value) => {
          compare.gain = 2 ** value;
        }),
      })),
    ], () => several || app.original !== null);
  }

  private material(): Control[] {
    const { surface } = this.state;
    return [group("Object", [
      choice("Shape", [["sphere", "Sphere"], ["plane", "Plane"], ["cloth", "Cloth"], ["mesh", "Mesh (open one first)"]],
        () => surface.shape, (shape) => {
          surface.shape = shape;
          this.app.resetView();
          this.changed();
        }, (shape) => shape !== "mesh" || this.app.mesh !== null),
      slider("Repeats", {
        min: 0, max: 3, step: 0.5, get: () => Math.log2(surface.repeat), show: (value) => `x ${plain(2 ** value)}`,
        set: this.change((value) => {
          surface.repeat = 2 ** value;
        }),
      }),
      check("Directions' y runs against the rows", () => surface.yUp, this.change((value) => {
        surface.yUp = value;
      })),
      check("Values lack the cosine", () => !surface.cosine, this.change((value) => {
        surface.cosine = !value;
      })),
    ]), this.lights(), this.time()];
  }

  private lights(): Control {
    const { lights } = this.state;
    const light = (): State["lights"][number] => lights[this.state.light]!;
    return group("Light", [
      only(() => lights.length > 1, this.lightChoice()),
      choice("Kind", [["sun", "Directional"], ["point", "Point"]], () => (light().point ? "point" : "sun"), (value) => {
        light().point = value === "point";
        light().intensity = light().point ? light().distance ** 2 : 1;
        this.changed();
      }),
      ...this.towards(light),
      only(() => light().point, slider("Distance", {
        min: 1.05, max: 10, step: 0.05, get: () => light().distance, set: this.change((value) => {
          light().distance = value;
        }),
      })),
      slider("Intensity", {
        min: -4, max: 6, step: 0.1, get: () => Math.log2(light().intensity), show: (value) => plain(2 ** value),
        set: this.change((value) => {
          light().intensity = 2 ** value;
        }),
      }),
      colour("Colour", () => light().colour, this.change((value) => {
        light().colour = value;
      })),
      this.lightCount(),
    ]);
  }

  /** Which of the lights the other controls show; options of lights that there are not are hidden. */
  private lightChoice(): Control {
    const select = choice("Light", Array.from({ length: MOST_LIGHTS }, (_, n) => [String(n), `Light ${n + 1}`] as const),
      () => String(this.state.light), (value) => {
        this.state.light = Number(value);
        this.changed();
      }, (value) => Number(value) < this.state.lights.length);
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
    const { lights } = this.state;
    return buttons({
      label: "Add a light", enabled: () => lights.length < MOST_LIGHTS, act: () => {
        lights.push(newLight(lights[this.state.light]!.azimuth + 120, 40));
        this.state.light = lights.length - 1;
        this.changed();
      },
    }, {
      label: "Remove", enabled: () => lights.length > 1, act: () => {
        lights.splice(this.state.light, 1);
        this.state.light = Math.min(this.state.light, lights.length - 1);
        this.changed();
      },
    });
  }

  /** Sliders for where a light comes from. */
  private towards(light: () => State["lights"][number]): Control[] {
    return [
      this.angle("Azimuth", -180, 180, () => light().azimuth, (value) => {
        light().azimuth = value;
      }),
      this.angle("Elevation", -90, 90, () => light().elevation, (value) => {
        light().elevation = value;
      }),
    ];
  }

  private lightfield(): Control[] {
    const { axes } = this.app.metadata;
    const { last } = findCameras(axes, layOut(axes, "lightfield"));
    const { view } = this.state;
    const along = (label: string, most: number, key: "row" | "column"): Control => only(() => most > 0, slider(label, {
      min: 0, max: most, step: 0.01, get: () => view[key], show: (value) => value.toFixed(2), set: this.change((value) => {
        view[key] = value;
      }),
    }));
    return [group("View point", [
      along("Row", last[0], "row"), along("Column", last[1], "column"),
      slider("Focus", {
        min: -8, max: 8, step: 0.05, get: () => view.focus, show: (value) => `${value.toFixed(2)} px`,
        set: this.change((value) => {
          view.focus = value;
        }),
      }),
      slider("Aperture", {
        min: 0, max: Math.max(1, Math.hypot(...last)), step: 0.1, get: () => view.aperture, set: this.change((value) => {
          view.aperture = value;
        }),
      }),
    ]), this.time()];
  }

  private volume(): Control[] {
    const { volume } = this.state;
    const iso = (): boolean => volume.mode === "iso";
    const names = { emission: "Glow", shaded: "Shaded", iso: "Iso-surface", maximum: "Brightest on the ray" };
    return [group("Look", [
      choice("Mode", VOLUME_MODES.map((mode) => [mode, names[mode]] as const), () => volume.mode, (mode) => {
        volume.mode = mode;
        this.changed();
      }),
      this.colourMap(() => volume.colours, (name) => {
        volume.colours = name;
      }),
      only(() => !iso() && volume.mode !== "maximum", transferEditor(() => volume.opacity, this.change((points) => {
        volume.opacity = points;
      }), () => volume.colours)),
      only(iso, slider("Iso value", {
        min: 0, max: 1, step: 0.005, get: () => volume.iso, show: (value) => plain(volume.low + value * (volume.high - volume.low)),
        set: this.change((value) => {
          volume.iso = value;
        }),
      })),
      ...this.window(() => volume),
      slider("Step", {
        min: 0.25, max: 2, step: 0.25, get: () => volume.step, show: (value) => `${value} voxel`, set: this.change((value) => {
          volume.step = value;
        }),
      }),
      this.clips(),
    ]), group("Light", this.towards(() => this.state.lights[0]!), () => volume.mode === "shaded" || iso()), this.time()];
  }

  /** Where the box begins and ends, folded away. */
  private clips(): Control {
    const { volume } = this.state;
    const clip = (name: string, axis: number, key: "clipLow" | "clipHigh"): Control => slider(name, {
      min: 0, max: 1, step: 0.01, get: () => volume[key][axis]!, show: (value) => `${Math.round(100 * value)} %`,
      set: this.change((value) => {
        const other = key === "clipLow" ? volume.clipHigh[axis]! : volume.clipLow[axis]!;
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
    const { slice } = this.state;
    const names = axes.map((axis, n) => [String(n), axis.name] as const);
    const pick = (label: string, key: "x" | "y"): Control => choice(label, names, () => String(slice[key]), (value) => {
      const other = key === "x" ? "y" : "x";
      if (slice[other] === Number(value)) {
        slice[other] = slice[key];
      }
      slice[key] = Number(value);
      this.state.pan = [0, 0];
      this.changed();
    });
    const channels = axes.some((axis) => axis.role === "channel" && axis.size > 2);
    return [group("Picture", [
      ...(axes.length > 1 ? [pick("Across", "x"), pick("Down", "y")] : []),
      only(() => channels, check("Channels as colours", () => slice.colour, (value) => {
        slice.colour = value;
        this.changed();
      })),
      only(() => colourAxis(this.app.metadata, this.state) === null, this.colourMap(() => slice.colours, (name) => {
        slice.colours = name;
      })),
      ...this.window(() => slice),
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
        set: this.change((value) => {
          this.state.position[n] = value;
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
