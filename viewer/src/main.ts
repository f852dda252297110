/** The page: finds the file, shows how far it has come, and everything that goes wrong as a sentence. */

import { App } from "./app";
import { pageTitle, pictureLabel } from "./figures";
import { type Gpu, openGpu } from "./gpu/device";
import { checkStart, load } from "./load";
import { originalProblem } from "./original";
import { Problem, asProblem, refusal } from "./problem";
import type { Reading } from "./reader/read";
import { Screen } from "./render/screen";
import type { Shown } from "./store";
import { BlobSource, type ByteSource, fileUrl, openUrl, present } from "./stream";
import { fixedSize, given, takeToken } from "./ui/address";
import { byId, tell } from "./ui/controls";
import { listenToDivider, placeDivider } from "./ui/divider";
import { placeErrorBar } from "./ui/errorBar";
import { facts } from "./ui/facts";
import { isMesh, listenForFiles, meshIn } from "./ui/files";
import type { Services } from "./ui/groups";
import { listenToMessage, say } from "./ui/message";
import { Panel } from "./ui/panel";
import { keepShape } from "./ui/place";
import { Player } from "./ui/player";
import { Pointer } from "./ui/pointer";
import { readout } from "./ui/readout";
import { savePicture } from "./ui/save";
import { listenToToggle, showPanel } from "./ui/shown";
import { Status } from "./ui/status";

const DEFAULT_FILE = "model.hmk";
const FIRST_FRAME = 600; // milliseconds that reading waits for it
/** What of the state controls show. */
const CONTROLLED = ["state", "kind", "arrived", "original", "mesh", "playing", "range"] as const;
const PARAMETERS = new URLSearchParams(location.search);

/** For tests and for programs that embed the page: what has happened so far. */
function publish(state: string): void {
  document.documentElement.dataset["state"] = state;
}

class Page {
  private app: App | null = null;
  private panel: Panel | null = null;
  private gpu: Gpu | null = null;
  private opening: Promise<void> = Promise.resolve();
  private screen: Promise<Screen> | null = null;
  private session = new AbortController();
  private pointed: [number, number] | null = null; // where the pointer rests on the picture
  private deepest = 0; // level that was on screen
  private told: Shown | null = null; // what was said last
  private source: ByteSource | null = null;
  private state = ""; // what has become of it
  private trial: ByteSource | null = null; // another file, which is looked at before it takes its place
  private notes = ""; // on how the model is shown
  private readonly status = new Status(() => this.gpu?.name ?? "");
  private readonly canvas = byId<HTMLCanvasElement>("canvas");

  async start(): Promise<void> {
    this.listen();
    showPanel(given(PARAMETERS, "panel") !== "closed");
    this.mark("starting");
    try {
      this.opening = this.openGpu();
      this.opening.catch(() => undefined); // whoever waits for it hears of the failure
      await this.openFile(given(PARAMETERS, "file"));
    } catch (error) {
      this.fail(asProblem(error));
    }
  }

  private mark(state: string): void {
    this.state = state;
    performance.mark(state);
    if (this.trial === null) {
      publish(state);
    }
  }

  /** Opens the adapter while the file begins to arrive. */
  private async openGpu(): Promise<void> {
    const gpu = await openGpu((problem) => {
      this.app?.close();
      this.gpu = null;
      this.opening = Promise.reject(problem);
      this.opening.catch(() => undefined); // whoever opens the next file hears of it
      this.fail(problem);
    });
    this.gpu = gpu;
    this.screen = Screen.make(gpu.device, this.canvas); // compiled beside what the model needs
    this.screen.catch(() => undefined); // whoever waits for it hears of the failure
    performance.mark("gpu");
  }

  /** The file that the address names, or one beside the page, or none. */
  private async openFile(name: string | null): Promise<void> {
    const { signal } = this.session; // aborted when a file is dropped on the page meanwhile
    const source = await openUrl(fileUrl(name ?? DEFAULT_FILE, location.href)).catch((error: unknown) => {
      if (name !== null && !signal.aborted) {
        throw error;
      }
      return null;
    });
    if (source === null && !signal.aborted) {
      await this.opening;
    }
    if (signal.aborted) {
      source?.close();
      return;
    }
    if (source === null) {
      byId("welcome").hidden = false;
      this.mark("empty");
      return;
    }
    const original = given(PARAMETERS, "original");
    await this.show(source, original === null ? "ready" : "model-ready");
    if (original !== null && this.showing && this.source === source) {
      await this.addOriginal(this.app!, original, this.session.signal);
    }
  }

  /** Load what to compare the model with; where that fails, the model stays on screen. */
  private async addOriginal(app: App, address: string, signal: AbortSignal): Promise<void> {
    byId("loading").textContent = "Loading the original ...";
    try {
      const source = await openUrl(fileUrl(address, location.href));
      if (signal.aborted) {
        source.close();
        return;
      }
      signal.addEventListener("abort", () => source.close());
      await app.setOriginal(await load(source, { onStart: () => undefined, onLevel: () => undefined }));
    } catch (error) {
      if (!signal.aborted && (this.state !== "failed" || byId("message").hidden)) { // what is said of the model matters more
        this.tell(originalProblem(error));
      }
    }
    if (!signal.aborted && !app.closed) {
      byId("loading").textContent = this.notes;
      if (this.state !== "failed") { // else levels are missing that could not be read
        this.mark("ready");
      }
    }
  }

  /** Show a file from its first bytes on, up to a state. */
  private async show(source: ByteSource, end = "ready"): Promise<void> {
    this.close();
    this.source = source;
    this.mark("loading");
    this.status.begin(() => this.speak());
    const { signal } = this.session;
    source.onBytes = () => {
      if (!signal.aborted) {
        this.status.progress(source.have, source.size);
      }
    };
    this.status.progress(source.have, source.size);
    try {
      await load(source, {
        onStart: (reading) => this.begin(reading, signal),
        onLevel: async ({ arrived }, level) => {
          signal.throwIfAborted();
          await this.app!.addLevel();
          signal.throwIfAborted();
          this.mark(`level-${level}`);
          if (level < arrived) { // the next one is there
            return;
          }
          // Let it be drawn before the next one is checked; a page that nobody sees is not drawn.
          await Promise.race([this.app!.drawn, new Promise((resolve) => setTimeout(resolve, FIRST_FRAME))]);
          await new Promise((resolve) => setTimeout(resolve));
          signal.throwIfAborted();
          this.addPanel();
        },
      });
    } catch (error) {
      if (!signal.aborted) { // else another file was opened, and what became of this one is nobody's business
        this.breakOff(source, error);
      }
      return;
    }
    if (!signal.aborted) {
      this.status.progress(source.size, source.size);
      if (this.state !== "failed") {
        this.mark(end);
      }
    }
  }

  /** What is whole of a file that failed stays on screen; without anything, the error is the page's. */
  private breakOff(source: ByteSource, error: unknown): void {
    if (!this.showing) {
      throw error;
    }
    source.onBytes = () => undefined; // what else arrives is not shown
    const [{ sentence, detail, next }, { arrived, metadata }] = [asProblem(error), this.app!];
    this.fail(new Problem(sentence, detail,
      `${next} The first ${arrived} of ${metadata.levels.length} levels are whole, and are shown.`));
  }

  /** Compile what the file needs; nothing of it is seen once another file was opened. */
  private async begin(reading: Reading, signal: AbortSignal): Promise<void> {
    performance.mark("read");
    await this.opening;
    signal.throwIfAborted();
    this.deepest = 0;
    const size = fixedSize(given(PARAMETERS, "pixels"), this.gpu!.device.limits.maxTextureDimension2D);
    keepShape(this.canvas, size !== null);
    const unlessAborted = <T>(tell: (told: T) => void) => (told: T): void => {
      if (!signal.aborted) {
        tell(told);
      }
    };
    const app = await App.make(this.gpu!, this.canvas, this.screen!, reading, this.source!.name, {
      onShown: unlessAborted((shown) => this.say(shown)),
      onProblem: unlessAborted((problem) => this.fail(problem)),
      onRefused: unlessAborted((problem) => this.tell(problem)),
      onNotes: unlessAborted((notes) => {
        this.notes = notes.join(" ");
        byId("loading").textContent = this.notes;
      }),
    }, size);
    if (signal.aborted) {
      app.close();
    }
    signal.throwIfAborted();
    this.app = app;
    performance.mark("compiled");
  }

  /** The controls, once the first picture is there. */
  private addPanel(): void {
    const { app } = this;
    if (app === null || this.panel !== null) {
      return;
    }
    this.speak();
    const save = (): void => void savePicture(app).catch((error: unknown) => app.closed || this.tell(asProblem(error)));
    const services: Services = { player: new Player(app, this.session.signal), save };
    this.panel = new Panel(app, byId("controls"), services);
    new Pointer(app, this.canvas, services, (place) => this.point(place), this.session.signal);
    let drawn = true; // an observer begins with the size that is there
    const observer = new ResizeObserver(() => {
      if (!drawn) {
        app.redraw();
      }
      drawn = false;
    });
    observer.observe(this.canvas);
    this.session.signal.addEventListener("abort", () => observer.disconnect());
  }

  /** Say on the page what is loaded, and how far it has come. */
  private speak(): void {
    const { source, app } = this;
    if (source === null) {
      return;
    }
    byId("file").textContent = source.name;
    document.title = pageTitle(source);
    byId("facts").textContent = app === null ? "" : facts(app.metadata, app.reading.size);
    this.status.speak();
  }

  private close(): void {
    this.session.abort();
    this.session = new AbortController();
    this.source?.close();
    this.app?.close();
    this.app = null;
    this.panel = null;
    this.trial = null;
    this.pointed = null;
    for (const id of ["message", "welcome", "readout", "divider", "error-bar"]) {
      byId(id).hidden = true;
    }
    byId("controls").replaceChildren();
    byId("facts").textContent = "";
    byId("loading").textContent = this.notes = "";
    this.status.clear();
  }

  /** Whether there is a picture that changes with the controls. */
  private get showing(): boolean {
    return this.app !== null && !this.app.closed && this.app.arrived > 0;
  }

  /** Say anew all that is a function of what is shown. */
  private say(shown: Shown): void {
    const { app, canvas } = this;
    if (app === null) { // which is being made
      return;
    }
    const { drawn } = shown;
    if (drawn?.whole === true && this.deepest < drawn.state.level) {
      this.deepest = drawn.state.level;
      performance.mark(`shown-level-${this.deepest}`);
    }
    canvas.classList.toggle("crisp", shown.kind === "generic");
    canvas.ariaLabel = pictureLabel(shown);
    placeDivider(app, canvas);
    placeErrorBar(shown);
    this.status.show(shown);
    this.point(this.pointed); // what is there may have changed
    const { told } = this;
    this.told = shown;
    if (told === null || CONTROLLED.some((key) => told[key] !== shown[key])) {
      this.panel?.refresh();
    }
  }

  /** Tell the value under the pointer. */
  private point(place: [number, number] | null): void {
    this.pointed = place;
    const text = this.app === null || place === null ? null : readout(this.app, place, this.canvas);
    tell(byId("readout"), text ?? "");
    byId("readout").hidden = text === null;
  }

  /** The file failed, or what shows it; a picture that there still is stays. */
  private fail(problem: Problem): void {
    this.tell(problem, this.showing);
    byId("welcome").hidden = true;
    if (this.showing) {
      this.status.endProgress();
    } else {
      this.session.abort(); // what still arrives of the file is not told of
      this.status.clear();
    }
    this.mark("failed");
  }

  /** Say what went wrong, beside what there is or in place of it. */
  private tell(problem: Problem, beside = true): void {
    this.speak();
    say(problem, beside);
  }

  private listen(): void {
    listenForFiles((file) => void this.take(file));
    listenToMessage();
    listenToToggle();
    listenToDivider(this.canvas, (position) => {
      if (this.app !== null) {
        this.app.choose((state) => {
          state.compare.position = position;
        });
      }
    });
  }

  /** A file that was dropped or chosen: a model, or a mesh to put the material on. */
  private async take(file: File): Promise<void> {
    try {
      await (isMesh(file) ? this.takeMesh(file) : this.takeModel(new BlobSource(file)));
    } catch (error) {
      if (this.showing || isMesh(file)) { // which harms nothing that is there, or on its way
        this.tell(refusal(file.name, error));
      } else {
        this.fail(asProblem(error));
      }
    }
  }

  private async takeModel(source: ByteSource): Promise<void> {
    if (this.showing && !await this.mayReplace(source)) {
      return;
    }
    await this.opening.catch(() => {
      this.opening = this.openGpu(); // it failed or was lost: once more
      return this.opening;
    });
    await this.show(source);
  }

  /** Whether a file may take the place of the model that is shown, which no other one did meanwhile; throws what is wrong with it. */
  private async mayReplace(source: ByteSource): Promise<boolean> {
    this.trial = source;
    publish("loading");
    const problem = await checkStart(source).then(() => null, asProblem);
    if (this.trial !== source) {
      return false;
    }
    this.trial = null;
    if (problem !== null) {
      publish(this.state);
      throw problem;
    }
    return true;
  }

  private async takeMesh(file: File): Promise<void> {
    if (this.app?.kind !== "svbrdf") {
      throw new Problem("A mesh can be shown with a material only.", "", "Open a material first.");
    }
    const make = await meshIn(file);
    make(1);
    this.app.setMesh(make);
  }
}

const token = takeToken(location, history, () => sessionStorage);
present(token === null ? null : { origin: location.origin, token });
void new Page().start();
