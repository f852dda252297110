/** One model on the page: its levels as they arrive, the renderer of what it is shown as, and the drawing of frames. */

import { SAMPLES, valueRange } from "./decode/element";
import { current } from "./figures";
import { EMPTY, type FrameEvent, type Frames, busy, next } from "./frames";
import { Decoder } from "./gpu/decoder";
import { type Gpu, guarded } from "./gpu/device";
import { asOriginal } from "./original";
import { Pace } from "./pace";
import { resetView } from "./places";
import { Problem, asProblem } from "./problem";
import { type FileKind, type Metadata, upto } from "./reader/metadata";
import type { Reading } from "./reader/read";
import { makeRenderer } from "./render/kinds";
import type { MeshMaker } from "./render/mesh";
import type { Progress, Renderer, Side } from "./render/renderer";
import { type Screen, toneOf } from "./render/screen";
import { SvbrdfRenderer } from "./render/svbrdf";
import type { State } from "./state";
import { type Action, type Drawn, type Shown, firstShown, reduced } from "./store";

const SETTLED = 250; // milliseconds after the last change
const LONG = 200; // milliseconds after which a picture that does not come is said to be decoded

/** What the page around is told. */
export interface Watcher {
  /** The state is another one: all that is shown is to be shown anew. */
  onShown(shown: Shown): void;
  onProblem(problem: Problem): void;
  /** What was chosen last cannot be drawn; what was shown before is shown again. */
  onRefused(problem: Problem): void;
  onNotes(notes: string[]): void;
}

/** A picture that is to be saved, of what was chosen then. */
interface Save {
  shown: Shown;
  done: PromiseWithResolvers<ImageData>;
}

export class App {
  readonly metadata: Metadata;
  shown: Shown; // changed by `dispatch` only
  private wanted: FileKind = "generic"; // the kind it shall become, once its renderer is ready
  mesh: MeshMaker | null = null; // the user's
  private decoder: Decoder; // that of the renderer
  private newest: Decoder; // of more levels, perhaps, once there is a renderer of it
  private originalDecoder: Decoder | null = null;
  private compared: Decoder | null = null; // the original, once the renderer has it
  private screen!: Screen; // there before anything is drawn
  private renderer: Renderer | null = null;
  private frames: Frames = EMPTY;
  private choices = 0; // of renderers, of which the last counts
  private readonly saves: Save[] = [];
  private readonly first = Promise.withResolvers<void>();
  private readonly pace: Pace;
  private proven: { kind: FileKind; state: State } | null = null; // what was drawn last

  private constructor(
    private readonly gpu: Gpu, private readonly canvas: HTMLCanvasElement, readonly reading: Reading, name: string,
    private readonly watcher: Watcher, fixedSize: [number, number] | null,
  ) {
    this.pace = new Pace(canvas, gpu.device.limits.maxTextureDimension2D, fixedSize);
    this.metadata = reading.metadata;
    this.decoder = this.newest = decoderOf(gpu.device, reading.metadata, reading);
    this.shown = firstShown(name, reading.metadata);
  }

  /** Prepare to show a model of which level 1 is read; frames have the given size, or the page's. */
  static make(
    gpu: Gpu, canvas: HTMLCanvasElement, screen: Promise<Screen>, reading: Reading, name: string, watcher: Watcher, size: [number, number] | null,
  ): Promise<App> {
    return guarded(gpu.device, "preparing the model", async () => {
      const app = new App(gpu, canvas, reading, name, watcher, size);
      [app.screen] = await Promise.all([screen, app.showAs(reading.metadata.kind)]);
      return app;
    });
  }

  get state(): State {
    return this.shown.state;
  }

  get kind(): FileKind {
    return this.shown.kind;
  }

  /** Levels that can be shown. */
  get arrived(): number {
    return this.shown.arrived;
  }

  get closed(): boolean {
    return this.frames.name === "closed";
  }

  /** Kept when a first frame has been drawn. */
  get drawn(): Promise<void> {
    return this.first.promise;
  }

  /** The only way to another state: draws what changed of the picture, and has all that is said of it said anew. */
  dispatch(action: Action): void {
    const before = this.shown;
    this.shown = reduced(before, action);
    if (this.shown.state !== before.state || this.shown.kind !== before.kind) {
      this.redraw();
    }
    this.watcher.onShown(this.shown);
  }

  /** Choose something, as controls, keys and pointers do. */
  choose(choose: (state: State) => void): void {
    this.dispatch({ type: "choose", choose });
  }

  /** The camera, view point and zoom that suit what is shown. */
  resetView(): void {
    this.choose((state) => resetView(state, this.metadata.axes, this.kind));
  }

  /** The next level is read. */
  async addLevel(): Promise<void> {
    if (this.newest.arrived === this.newest.metadata.levels.length) {
      await this.grow();
    }
    this.newest.addLevel();
    this.dispatch({ type: "arrive" });
    const { kind, arrived, metadata } = this.shown;
    // What needs no more than a white has it measured while the first frame is decoded.
    if ((arrived === 1 && kind !== "svbrdf" && kind !== "lightfield") || (arrived > 1 && arrived === metadata.levels.length)) {
      this.measure();
    }
    this.redraw();
  }

  /** Have a decoder of all that is read by now, and a renderer of it; what there is shows the first levels until then. */
  private async grow(): Promise<void> {
    const { device } = this.gpu;
    const { arrived } = this.newest;
    const made = await guarded(device, "preparing further levels", () => decoderOf(device, this.metadata, this.reading, arrived));
    this.newest = made;
    await this.showAs(this.wanted);
    if (this.closed) {
      made.destroy();
    }
  }

  /** A model to compare with, all of whose levels are there; where that fails, all stays as it was. */
  async setOriginal(original: Reading): Promise<void> {
    const { device } = this.gpu;
    const metadata = asOriginal(original.metadata, this.metadata.axes);
    const { arrived } = original;
    const decoder = await guarded(device, "preparing the original", () => decoderOf(device, metadata, original, arrived));
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
    this.dispatch({ type: "original" });
  }

  /** Change the renderer; what the axes do not make is shown as slices, with the reason. */
  async showAs(kind: FileKind): Promise<void> {
    const choice = ++this.choices;
    this.wanted = kind;
    await this.use(kind, choice).catch((error: unknown) => this.use("generic", choice, [asProblem(error).message]));
  }

  /** Have another renderer, of the model and the original that there is by now. */
  private async use(kind: FileKind, choice: number, notes: string[] = []): Promise<void> {
    const decoders = [this.newest, ...(this.originalDecoder === null ? [] : [this.originalDecoder])];
    const renderer = await makeRenderer(this.gpu.device, kind, this.metadata, decoders, [this.state, ...this.pace.size(true)]);
    await Promise.allSettled(this.saves.map(({ done }) => done.promise)); // which are drawn by the one that there is
    if (this.closed || choice !== this.choices) { // another choice came before this one was ready
      renderer.destroy();
      return;
    }
    const before = this.renderer === null ? null : this.kind;
    this.wanted = kind;
    this.renderer?.destroy();
    this.renderer = renderer;
    if (this.decoder !== decoders[0]) {
      this.decoder.destroy();
      this.decoder = decoders[0]!;
    }
    if (renderer instanceof SvbrdfRenderer && this.mesh !== null) {
      renderer.setMesh(this.mesh);
    }
    this.compared = decoders[1] ?? null;
    this.pace.reset();
    this.watcher.onNotes([...notes, ...renderer.notes]);
    if (kind !== before) { // else an original came, and the view stays
      this.dispatch({ type: "show-as", kind });
    }
    this.redraw();
  }

  /** Say what went wrong, unless another file is shown by now. */
  fail(error: unknown): void {
    if (!this.closed) {
      this.watcher.onProblem(asProblem(error));
    }
  }

  /** Show a mesh of the user's. */
  setMesh(make: MeshMaker): void {
    if (this.renderer instanceof SvbrdfRenderer) {
      this.mesh = make;
      this.renderer.setMesh(make);
      this.dispatch({ type: "mesh" });
      this.redraw();
    }
  }

  /** Draw soon, for something has changed: what is chosen, or the page. */
  redraw(): void {
    if (this.decoder.arrived > 0) {
      this.send({ type: "change", now: performance.now() });
    }
  }

  /** The chosen picture at its full size, once nothing of it is missing. */
  picture(): Promise<ImageData> {
    const save = { shown: this.shown, done: Promise.withResolvers<ImageData>() };
    this.saves.push(save);
    this.send({ type: "save" });
    return save.done.promise;
  }

  /** Free what the model takes on the GPU. */
  close(): void {
    this.send({ type: "close" });
    this.saves.splice(0).forEach(({ done }) => done.reject(new Problem("Another file was opened before the picture was saved.")));
    this.renderer?.destroy();
    this.decoder.destroy();
    this.newest.destroy();
    this.originalDecoder?.destroy();
  }

  /** What shows as white, and windows, from a sample of the values; not all of it is taken until all levels are there. */
  private measure(): void {
    const { arrived } = this.decoder;
    const samples = arrived < this.metadata.levels.length ? SAMPLES / 8 : SAMPLES;
    const range = valueRange(this.metadata, this.reading.stages, arrived, samples);
    this.shown = reduced(this.shown, { type: "range", range }); // whoever measures draws
    this.watcher.onShown(this.shown);
  }

  private send(event: FrameEvent): void {
    const before = this.frames;
    this.frames = next(before, event);
    if (this.frames.name !== before.name) {
      this.canvas.setAttribute("aria-busy", String(busy(this.frames)));
      this.enter();
    }
  }

  /** Do what a state of the frames is for. */
  private enter(): void {
    const { name, since } = this.frames;
    if (name === "waiting") {
      const begin = (): void => this.send({ type: "begin", saving: this.saves.length > 0 });
      if (this.shown.drawn?.whole === true) {
        requestAnimationFrame(begin);
      } else { // nothing is shown yet that could be drawn too often
        queueMicrotask(begin);
      }
    } else if (name === "drawing") {
      void this.frame();
    } else if (name === "saving") {
      void this.save(this.saves[0]!);
    } else if (name === "resting") {
      setTimeout(() => this.send({ type: "rested", since }), Math.max(0, SETTLED - (performance.now() - since)));
    }
  }

  /** Draw one frame. What cannot be drawn is not shown: what was drawn last is shown again, once; else nothing, until something changes. */
  private async frame(): Promise<void> {
    const long = setTimeout(() => {
      if (this.shown.share === 1 && !current(this.shown)) {
        this.dispatch({ type: "share", share: 0 });
      }
    }, LONG);
    try {
      this.send({ type: "drawn", ...await this.drawFrame() });
    } catch (error) {
      if (!this.closed) { // else a frame was under way when another file took its place
        await this.takeBack(asProblem(error));
      }
      this.send({ type: "failed" });
    } finally {
      clearTimeout(long);
    }
  }

  private async takeBack(problem: Problem): Promise<void> {
    const { proven } = this;
    this.proven = null;
    if (proven === null) {
      this.dispatch({ type: "share", share: 1 });
      this.watcher.onProblem(problem);
      return;
    }
    if (proven.kind !== this.kind) {
      await this.showAs(proven.kind).catch(() => undefined); // the problem that there was says more
    }
    this.dispatch({ type: "restore", state: proven.state });
    this.redraw();
    this.watcher.onRefused(problem);
  }

  private sides({ level, compare: { mode, level: other } }: State): Side[] {
    const { decoder } = this;
    const side = (wanted: number): Side => ({ decoder, level: Math.min(wanted, decoder.arrived) }); // others may wait for a renderer
    if (mode === "none") {
      return [side(level)];
    }
    return other === null && this.compared !== null
      ? [side(level), { decoder: this.compared, level: this.compared.arrived }]
      : [side(level), side(other ?? 1)];
  }

  /** What is chosen once all is compiled that it needs; levels may arrive meanwhile, and anything be changed. */
  private async prepared(): Promise<State> {
    for (;;) {
      const [{ state }, { renderer }] = [this.shown, this];
      await renderer!.prepare?.(state, this.sides(state));
      if (state === this.shown.state && renderer === this.renderer) {
        return state;
      }
    }
  }

  private async drawFrame(): Promise<{ again: boolean; coarse: boolean }> {
    const state = await this.prepared();
    const moving = performance.now() - this.frames.since < SETTLED || this.shown.share < 1;
    const [width, height] = this.pace.size(moving);
    const start = performance.now();
    const { share, decoded, drawn } = await guarded(this.gpu.device, "drawing", async () => {
      const progress = this.drawSides(state, width, height);
      const presented = this.present(progress.share);
      await this.gpu.device.queue.onSubmittedWorkDone();
      this.renderer!.ahead?.(); // behind the picture, not beside it: they would share the processor
      return { ...progress, drawn: presented };
    });
    this.proven = { kind: this.kind, state };
    this.first.resolve();
    const milliseconds = performance.now() - start;
    const again = this.pace.learn(width * height, milliseconds, decoded);
    if (drawn !== null) {
      this.dispatch({ type: "drawn", drawn: { ...drawn, width, height, milliseconds } });
    }
    return { again: again || share < 1, coarse: this.pace.size(false)[0] > width };
  }

  /** Put on the canvas what was just drawn. What is half decoded is shown only while there is nothing else, as such, and never compared with. */
  private present(share: number): Pick<Drawn, "kind" | "state" | "whole"> | null {
    if (this.shown.range === null) {
      this.measure();
    }
    const { state, kind, drawn } = this.shown;
    const whole = share === 1;
    if (!whole) {
      this.dispatch({ type: "share", share });
    }
    if (!whole && (drawn?.whole === true || state.compare.mode !== "none")) {
      return null;
    }
    this.screen.present(state, toneOf(this.shown));
    return { kind, state, whole };
  }

  /** Draw a picture in full, however long that takes. */
  private async save({ shown, done }: Save): Promise<void> {
    const { state } = shown;
    const { device } = this.gpu;
    try {
      for (let share = 0; share < 1;) {
        this.dispatch({ type: "saving", saving: share });
        await this.renderer!.prepare?.(state, this.sides(state));
        const drawing = async (): Promise<void> => {
          ({ share } = this.drawSides(state, ...this.pace.full));
          await device.queue.onSubmittedWorkDone();
        };
        await guarded(device, "drawing the picture to save", drawing);
      }
      done.resolve(await guarded(device, "saving the picture", () => this.screen.read(state, toneOf(shown))));
    } catch (error) {
      done.reject(error);
    }
    this.saves.shift();
    if (!this.closed) {
      this.dispatch({ type: "saving", saving: null });
    }
    this.send({ type: "saved" });
  }

  private drawSides(state: State, width: number, height: number): Progress {
    this.screen.resize(width, height);
    const sides = this.sides(state);
    const parts = sides.map((side, n) =>
      this.renderer!.draw(side, n as 0 | 1, state, this.screen.pictures[n]!, this.pace.budget / sides.length));
    const share = parts.reduce((sum, part) => sum + part.share, 0) / parts.length;
    return { share, decoded: parts.reduce((sum, part) => sum + part.decoded, 0) };
  }
}

/** A decoder of the levels that are read; the numbers of some of them are there. */
function decoderOf(device: GPUDevice, metadata: Metadata, { stages, arrived }: Reading, filled = 0): Decoder {
  const read = upto(metadata, arrived);
  const made = new Decoder(device, read, stages.slice(0, read.stages.length));
  while (made.arrived < filled) {
    made.addLevel();
  }
  return made;
}
