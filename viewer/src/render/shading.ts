/** The shaders of one material: of level 1, of all levels, and of lights that are the same at all pixels. */

import { FrameContraction, type Still } from "../gpu/frameContraction";
import type { Decoder } from "../gpu/decoder";
import { payingModes } from "../gpu/payingModes";
import { Pass } from "../gpu/pass";
import { pickedPrelude } from "../gpu/picked";
import { type Options, picksFit } from "../gpu/prelude";
import { pickedFiles } from "../gpu/shaders";
import { firstStages } from "../gpu/tree";
import { type Metadata, levelEnds } from "../reader/metadata";
import type { Layout } from "./layout";

const FLAG_NEAREST = 4;
const FLAG_NEAREST_AZIMUTH = 8;

/** A shader and how its model is contracted. */
interface Shader {
  pass: Pass;
  frame: FrameContraction;
}

/** Compiled when it is first asked for. */
class Later<Made> {
  made: Made | null = null;
  private making: Promise<void> | null = null;

  constructor(private readonly make: () => Promise<Made>) {}

  ready(): Promise<void> {
    return this.making ??= this.make().then((made) => {
      this.made = made;
    });
  }
}

/** What a material's shaders are made for. */
export interface Directed {
  layout: Layout;
  axes: number[][]; // of views and of lights, zeniths before azimuths
  still: number[];
}

export class Shading {
  /** Flags of what stays uninterpolated, because a mode holds too much. */
  readonly flags: number;
  private readonly picks: number[];
  private readonly channels: 1 | 3;
  private readonly general: FrameContraction;
  private readonly fixed: FrameContraction | null; // null: it would not pay
  private first: Pass | null = null;
  private readonly all: Later<Pass>;
  private readonly lit: Later<Pass>;

  private constructor(private readonly device: GPUDevice, private readonly decoder: Decoder, private readonly directed: Directed) {
    const { layout, still } = directed;
    const { metadata } = decoder;
    this.channels = layout.channel !== null && layout.channels.length === 3 ? 3 : 1;
    [this.picks, this.flags] = choosePicks(metadata, directed, this.channels);
    const modes = (fixed: number[]): number[] => payingModes(decoder, this.options([]), still, fixed, layout.channel);
    const [general, fixed] = [modes([]), (this.flags & FLAG_NEAREST_AZIMUTH) !== 0 ? modes([]) : modes(layout.lights)];
    const contraction = (contracted: number[]): FrameContraction => new FrameContraction(device, decoder, this.options(contracted));
    this.general = contraction(general);
    this.fixed = fixed.join() === general.join() ? null : contraction(fixed);
    const one = metadata.levels.length === 1;
    this.all = new Later(async () => (one ? this.first! : this.compile(metadata.stages.length, this.general, false)));
    this.lit = new Later(async () => {
      const [pass] = await Promise.all([this.compile(metadata.stages.length, this.fixed!, true), this.fixed!.compile()]);
      return pass;
    });
  }

  /** Compile what shows level 1, which has a shader of its own: it takes a fraction of the time to compile. */
  static async make(device: GPUDevice, decoder: Decoder, directed: Directed): Promise<Shading> {
    const made = new Shading(device, decoder, directed);
    [made.first] = await Promise.all([
      made.compile(levelEnds(decoder.metadata)[0]!, made.general, false), made.general.compile(),
    ]);
    return made;
  }

  /** Whether lights that are the same at all pixels are contracted. */
  contracts(sets: Still[] | null): boolean {
    return sets !== null && this.fixed !== null && this.fixed.fits(sets.length);
  }

  /** Compile what a level needs. */
  async prepare(level: number, fixed: boolean): Promise<void> {
    await (fixed ? this.lit.ready() : level === 1 ? undefined : this.all.ready());
  }

  /** Begin to compile what deeper levels need. */
  ahead(): void {
    this.all.ready().catch(() => undefined); // `prepare` hears of a failure
  }

  /** The shader of a level, once it is prepared. */
  shader(level: number, fixed: boolean): Shader {
    return fixed ? { pass: this.lit.made!, frame: this.fixed! }
      : { pass: level === 1 ? this.first! : this.all.made!, frame: this.general };
  }

  destroy(): void {
    [this.first, this.all.made, this.lit.made, this.general, this.fixed].forEach((each) => each?.destroy());
  }

  private options(contracted: number[]): Options {
    return { picks: this.picks, channels: this.channels, contracted };
  }

  /** Compile what adds up the first stages. */
  private compile(stages: number, frame: FrameContraction, fixed: boolean): Promise<Pass> {
    const { tree, pages } = this.decoder;
    const options = this.options(frame.contracted);
    const gridded = this.directed.axes.some((axes) => axes.length > 1);
    const head = `${pickedPrelude(firstStages(tree, stages), pages, options)}const ANGLES = ${gridded};\nconst FIXED_LIGHT = ${fixed};\n`;
    return Pass.make(this.device, {
      entry: "shade_svbrdf", struct: "SvbrdfFrame", decoder: frame.layout, head, shaders: pickedFiles(head, "svbrdf"),
      bindings: ["storage", "texture-2d", "texture-2d", "texture-2d", "store-2d"],
    });
  }
}

/** Room for the picks of each axis, and flags for what must stay uninterpolated because a mode holds too much. */
function choosePicks(metadata: Metadata, { layout, axes }: Directed, channels: 1 | 3): [number[], number] {
  const made = (texels: number, azimuths: number): number[] => {
    const picks = metadata.axes.map(() => 1);
    axes.forEach(([one, two]) => {
      if (one !== undefined) {
        picks[one] = two === undefined ? 3 : 2;
      }
      if (two !== undefined) {
        picks[two] = azimuths;
      }
    });
    layout.space.forEach((axis) => {
      picks[axis] = texels;
    });
    if (channels === 3) {
      picks[layout.channel!] = 3;
    }
    return picks;
  };
  const ways: [number[], number][] = [
    [made(2, 2), 0], [made(1, 2), FLAG_NEAREST], [made(1, 1), FLAG_NEAREST + FLAG_NEAREST_AZIMUTH],
  ];
  return ways.find(([picks]) => picksFit(metadata, picks)) ?? ways[2]!; // if it does not fit, making the prelude says so
}
