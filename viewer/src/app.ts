/** One model on the page: its levels as they arrive, the renderer of what it is shown as, and the drawing of frames. */

import { SAMPLES, type ValueRange, valueRange } from "./decode/element";
import { Decoder } from "./gpu/decoder";
import { type Gpu, guarded } from "./gpu/device";
import { asOriginal } from "./original";
import { Pace } from "./pace";
import { carryPlaces, startPlaces } from "./places";
import { type Problem, asProblem } from "./problem";
import type { FileKind, Metadata } from "./reader/metadata";
import type { Reading } from "./reader/read";
import { LightfieldRenderer, findCameras } from "./render/lightfield";
import { layOut } from "./render/layout";
import type { MeshMaker } from "./render/mesh";
import type { Progress, Renderer, Side } from "./render/renderer";
import { Screen } from "./render/screen";
import { SliceRenderer } from "./render/slices";
import { SvbrdfRenderer } from "./render/svbrdf";
import { VolumeRenderer } from "./render/volume";
import { startWindows } from "./render/window";
import { type State, newState, restore } from "./state";

const SETTLED = 250; // milliseconds after the last change
const CAMERAS = { svbrdf: [20, 20, 3.4], volume: [30, 25, 5.4], plane: [0, 0, 3.6], cloth: [20, 38, 5.3] } as const;

export interface Statistics {
  milliseconds: number;
  width: number;
  height: number;
  decoding: boolean;
  level: number;
}

/** What the page around is told. */
export interface Watcher {
  onFrame(statistics: Statistics): void;
  onProblem(problem: Problem): void;
  /** What was chosen last cannot be drawn; what was shown before is shown again. */
  onRefused(problem: Problem): void;
  onNotes(notes: string[]): void;
}

export class App {
  readonly metadata: Metadata;
  state: State;
  kind: FileKind = "generic";
  private wanted: FileKind = "generic"; // the kind it shall become, once its renderer is ready
  original: Reading | null = null;
  mesh: MeshMaker | null = null; // the user's
  private readonly decoder: Decoder;
  private originalDecoder: Decoder | null = null;
  private compared: Decoder | null = null; // the original, once the renderer has it
  private screen!: Screen; // there before anything is drawn
  private renderer: Renderer | null = null;
  private white = 1;
  private unmeasured = false;
  private dirty = false;
  private drawing = false;
  closed = false;
  private choices = 0; // of renderers, of which the last counts
  private changed = 0; // when something last did, and how often
  private changes = 0;
  private pending = false; // something is still to be decoded
  private readonly first = Promise.withResolvers<void>();
  private whole = false; // a picture with nothing missing has been shown
  private readonly pace: Pace;
  private proven: { kind: FileKind; state: State } | null = null; // what was drawn last

  private constructor(
    private readonly gpu: Gpu, private readonly canvas: HTMLCanvasElement, readonly reading: Reading,
    private readonly watcher: Watcher, fixedSize: [number, number] | null,
  ) {
    this.pace = new Pace(canvas, gpu.device.limits.maxTextureDimension2D, fixedSize);
    this.metadata = reading.metadata;
    this.decoder = new Decoder(gpu.device, reading.metadata, reading.levels);
    this.state = newState(reading.metadata.axes.length);
    startPlaces(this.state, reading.metadata.axes);
  }

  /** Prepare to show a model whose tables are there; frames have the given size, or the page's. */
  static make(
    gpu: Gpu, canvas: HTMLCanvasElement, screen: Promise<Screen>, reading: Reading, watcher: Watcher, size: [number, number] | null,
  ): Promise<App> {
    return guarded(gpu.device, "preparing the model", async () => {
      const app = new App(gpu, canvas, reading, watcher, size);
      [app.screen] = await Promise.all([screen, app.showAs(reading.metadata.kind)]);
      return app;
    });
  }

  /** Levels that can be shown. */
  get arrived(): number {
    return this.decoder.arrived;
  }

  /** Kept when a first frame has been drawn. */
  get drawn(): Promise<void> {
    return this.first.promise;
  }

  /** Whether the picture still lacks elements. */
  get decoding(): boolean {
    return this.pending;
  }

  /** The next level has arrived; it is shown unless another one was chosen. */
  addLevel(): void {
    const follow = this.decoder.arrived === 0 || this.state.level === this.decoder.arrived;
    this.decoder.addLevel();
    const arrived = this.decoder.arrived;
    if (follow) {
      this.state.level = arrived;
    }
    // What needs no more than a white has it measured while the first frame is decoded.
    this.unmeasured = arrived === 1 && (this.kind === "svbrdf" || this.kind === "lightfield");
    if (!this.unmeasured && (arrived === 1 || arrived === this.metadata.levels.length)) {
      this.measure(arrived === 1);
    }
    this.redraw();
  }

  /** A model to compare with, all of whose levels are there; where that fails, all stays as it was. */
  async setOriginal(original: Reading): Promise<void> {
    const { device } = this.gpu;
    const metadata = asOriginal(original.metadata, this.metadata.axes);
    const decoder = await guarded(device, "preparing the original", () => {
      const made = new Decoder(device, metadata, original.levels);
      original.levels.forEach(() => made.addLevel());
      return made;
    });
    this.originalDecoder = decoder;
    const choice = ++this.choices;
    try {
      await this.use(this.wanted, choice);
    } catch (error) {
      this.originalDecoder = null;
      if (choice !== this.choices) { // a renderer that was chosen meanwhile may have it
        await this.showAs(this.wanted);
      }
      decoder.destroy();
      throw error;
    }
    if (this.closed) {
      decoder.destroy();
    }
    this.original = original;
    this.state.compare.level = null;
  }

  /** What the file can be shown as: its kind, if its axes make it, and slices. */
  kinds(): FileKind[] {
    const { kind, axes } = this.metadata;
    try {
      return kind === "generic" ? ["generic"] : (layOut(axes, kind), [kind, "generic"]);
    } catch {
      return ["generic"];
    }
  }

  /** Change the renderer; what the axes do not make is shown as slices, with the reason. */
  async showAs(kind: FileKind): Promise<void> {
    const choice = ++this.choices;
    this.wanted = kind;
    await this.use(kind, choice).catch((error: unknown) => this.use("generic", choice, [asProblem(error).message]));
  }

  /** Have another renderer, of the model and the original that there is by now. */
  private async use(kind: FileKind, choice: number, notes: string[] = []): Promise<void> {
    const decoders = [this.decoder, ...(this.originalDecoder === null ? [] : [this.originalDecoder])];
    const renderer = await this.made(kind, decoders);
    if (this.closed || choice !== this.choices) { // another choice came before this one was ready
      renderer.destroy();
      return;
    }
    const before = this.renderer === null ? null : this.kind;
    this.kind = this.wanted = kind;
    this.renderer?.destroy();
    this.renderer = renderer;
    if (renderer instanceof SvbrdfRenderer && this.mesh !== null) {
      renderer.setMesh(this.mesh);
    }
    this.compared = decoders[1] ?? null;
    this.pace.reset();
    this.whole = false;
    this.watcher.onNotes([...notes, ...renderer.notes]);
    if (kind !== before) { // else an original came, and the view stays
      this.resetView();
      carryPlaces(this.state, this.metadata.axes, before ?? kind, kind);
    }
    this.redraw();
  }

  private made(kind: FileKind, decoders: Decoder[]): Promise<Renderer> {
    const { device } = this.gpu;
    switch (kind) {
      case "svbrdf": return SvbrdfRenderer.make(device, this.metadata, decoders, [this.state, ...this.pace.size(true)]);
      case "lightfield": return LightfieldRenderer.make(device, this.metadata, decoders);
      case "volume": return VolumeRenderer.make(device, this.metadata, decoders);
      default: return SliceRenderer.make(device, decoders);
    }
  }

  /** Say what went wrong, unless another file is shown by now. */
  fail(error: unknown): void {
    if (!this.closed) {
      this.watcher.onProblem(asProblem(error));
    }
  }

  /** The camera, view point and zoom that suit what is shown. */
  resetView(): void {
    const { shape } = this.state.surface;
    const key = this.kind === "volume" ? "volume" : shape === "plane" || shape === "cloth" ? shape : "svbrdf";
    const [azimuth, elevation, distance] = CAMERAS[key];
    this.state.camera = { azimuth, elevation, distance, fov: 38, target: [0, 0, 0] };
    this.state.zoom = 1;
    this.state.pan = [0, 0];
    if (this.kind === "lightfield") {
      const { last } = findCameras(this.metadata.axes, layOut(this.metadata.axes, "lightfield"));
      Object.assign(this.state.view, { row: last[0] / 2, column: last[1] / 2 });
    }
  }

  /** Show a mesh of the user's. */
  setMesh(make: MeshMaker): void {
    if (this.renderer instanceof SvbrdfRenderer) {
      this.mesh = make;
      this.renderer.setMesh(make);
      this.state.surface.shape = "mesh";
      this.redraw();
    }
  }

  /** Draw soon, for something has changed. */
  redraw(): void {
    this.changed = performance.now();
    this.changes += 1;
    this.dirty = true;
    if (!this.drawing && !this.closed && this.decoder.arrived > 0) {
      this.drawing = true;
      this.canvas.setAttribute("aria-busy", "true");
      if (this.whole) {
        requestAnimationFrame(() => void this.drawFrames());
      } else { // nothing is shown yet that could be drawn too often
        void this.drawFrames();
      }
    }
  }

  /** Free what the model takes on the GPU. */
  close(): void {
    this.closed = true;
    this.renderer?.destroy();
    this.decoder.destroy();
    this.originalDecoder?.destroy();
  }

  /** White and windows from a sample of the values. */
  private measure(first: boolean): void {
    this.unmeasured = false;
    const { arrived } = this.decoder;
    const provisional = arrived < this.metadata.levels.length; // measured again with all levels
    this.range = valueRange(this.metadata, this.reading.levels, arrived, provisional ? SAMPLES / 8 : SAMPLES);
    this.white = this.range.high > 0 ? this.range.high : 1;
    if (first || !this.windowTouched) {
      startWindows(this.state, this.range);
    }
  }

  /** The values' range, for sliders; and whether the window was changed by hand. */
  range: ValueRange = { low: 0, high: 1, least: 0, most: 1 };
  windowTouched = false;

  private async drawFrames(): Promise<void> {
    while (this.dirty && !this.closed) {
      this.dirty = false;
      try {
        await this.drawFrame();
      } catch (error) {
        if (!this.closed) { // else a frame was under way when another file took its place
          await this.takeBack(asProblem(error));
        }
      }
    }
    this.drawing = false;
    this.canvas.setAttribute("aria-busy", "false");
  }

  /** What cannot be drawn is not shown: what was drawn last is shown again, once; else nothing, until something changes. */
  private async takeBack(problem: Problem): Promise<void> {
    const { proven } = this;
    this.proven = null;
    if (proven === null) {
      this.watcher.onProblem(problem);
      return;
    }
    if (proven.kind !== this.kind) {
      await this.showAs(proven.kind).catch(() => undefined); // the problem that there was says more
    }
    restore(this.state, proven.state);
    this.dirty = true;
    this.watcher.onRefused(problem);
  }

  private sides(): Side[] {
    const level = Math.min(this.state.level, this.decoder.arrived);
    const { mode, level: other } = this.state.compare;
    const first: Side = { decoder: this.decoder, level };
    if (mode === "none") {
      return [first];
    }
    return other === null && this.compared !== null
      ? [first, { decoder: this.compared, level: this.compared.arrived }]
      : [first, { decoder: this.decoder, level: Math.min(other ?? 1, this.decoder.arrived) }];
  }

  /** The sides once all is compiled that they need; levels may arrive meanwhile, and anything be changed. */
  private async preparedSides(): Promise<Side[]> {
    for (let before = -1; before !== this.changes;) {
      before = this.changes;
      await this.renderer!.prepare?.(this.state, this.sides());
    }
    return this.sides();
  }

  private async drawFrame(): Promise<void> {
    const sides = await this.preparedSides();
    const moving = performance.now() - this.changed < SETTLED || this.pending;
    const [width, height] = this.pace.size(moving);
    const start = performance.now();
    const drawn = { kind: this.kind, state: structuredClone(this.state) };
    const { complete, decoded } = await guarded(this.gpu.device, "drawing", () => this.drawSides(sides, width, height));
    this.proven = drawn;
    this.first.resolve();
    const milliseconds = performance.now() - start;
    this.pending = !complete;
    const again = this.pace.learn(width * height, milliseconds, decoded);
    this.dirty ||= again; // a change during the frame stays to be drawn
    this.watcher.onFrame({ milliseconds, width, height, decoding: !complete, level: sides[0]!.level });
    if (!this.dirty) {
      await this.refine(width);
    }
    await new Promise((resolve) => requestAnimationFrame(resolve));
  }

  private async drawSides(sides: Side[], width: number, height: number): Promise<Progress> {
    this.screen.resize(width, height);
    const parts = sides.map((side, n) =>
      this.renderer!.draw(side, n as 0 | 1, this.state, this.screen.pictures[n]!, this.pace.budget / sides.length));
    if (this.unmeasured) {
      this.measure(true);
    }
    const complete = parts.every((part) => part.complete);
    // What is half decoded is shown only while there is nothing else, and never compared with.
    if (complete || (sides.length === 1 && !this.whole)) {
      this.present();
    }
    this.whole ||= complete;
    await this.gpu.device.queue.onSubmittedWorkDone();
    this.renderer!.ahead?.(); // behind the picture, not beside it: they would share the processor
    return { complete, decoded: parts.reduce((sum, part) => sum + part.decoded, 0) };
  }

  private present(): void {
    this.screen.present(this.state, {
      white: this.kind === "svbrdf" || this.kind === "lightfield" ? this.white : 1, srgb: this.kind === "svbrdf",
      premultiplied: this.kind === "volume",
    });
  }

  /** Once nothing has moved for a while, draw again in full. */
  private async refine(width: number): Promise<void> {
    if (this.pace.size(false)[0] <= width) {
      return;
    }
    const wait = SETTLED - (performance.now() - this.changed);
    const change = this.changed;
    await new Promise((resolve) => setTimeout(resolve, Math.max(0, wait)));
    this.dirty ||= change === this.changed && this.pace.size(false)[0] > width;
  }
}
