/** Chromium with WebGPU in software, the server, and the page's pixels. */

import { type ChildProcess, execFileSync, spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { type Browser, type Locator, type Page, chromium } from "playwright-core";
import { PNG } from "pngjs";
import { afterAll, afterEach, beforeAll } from "vitest";

const ROOT = join(import.meta.dirname, "..", "..");
export const PYTHON = join(ROOT, ".venv", "bin", "python");
const CHROMIUM = process.env["CHROMIUM"] ?? "/usr/bin/chromium";

/** All four of the first are needed: without any one of them the first picture ends the device. */
const FLAGS = ["--enable-unsafe-webgpu", "--enable-features=Vulkan", "--use-vulkan=swiftshader", "--use-angle=vulkan",
  "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
  "--disable-sync"];

/** Whether there is a browser; where CI says that there must be, its absence is an error. */
export function haveBrowser(): boolean {
  const missing = [CHROMIUM, PYTHON].filter((path) => !existsSync(path));
  if (missing.length > 0 && process.env["CI"] === "true") {
    throw new Error(`the viewer's tests need ${missing.join(" and ")}: apt-get install chromium, make`);
  }
  return missing.length === 0;
}

export function launch(flags: string[] = FLAGS): Promise<Browser> {
  return chromium.launch({ executablePath: CHROMIUM, args: flags });
}

export const WITHOUT_WEBGPU = FLAGS.filter((flag) => !flag.includes("webgpu") && !flag.includes("ulkan")).concat(
  "--disable-features=WebGPU", "--disable-gpu", "--disable-webgpu");

/** The folder with the test models, gone after the file's tests. */
export function makeModels(): string {
  const folder = mkdtempSync(join(tmpdir(), "hmkcta-viewer-"));
  afterAll(() => rmSync(folder, { recursive: true }));
  execFileSync(PYTHON, [join(ROOT, "tests", "make_viewer_models.py"), folder],
    { env: { ...process.env, OPENBLAS_NUM_THREADS: "1" } });
  return folder;
}

/** A running `hmkcta view`. */
export class Server {
  private constructor(private readonly process: ChildProcess, readonly url: string) {}

  static async start(file: string, ...options: string[]): Promise<Server> {
    const process = spawn(PYTHON, ["-m", "hmkcta", "view", file, "--no-browser", ...options],
      { stdio: ["ignore", "pipe", "inherit"] });
    const url = await new Promise<string>((resolve, reject) => {
      let text = "";
      process.stdout.on("data", (part: Buffer) => {
        text += part.toString();
        const found = /http:\S+/.exec(text);
        if (found !== null) {
          resolve(found[0]);
        }
      });
      process.on("exit", (code) => reject(new Error(`hmkcta view ended with code ${code}`)));
    });
    return new Server(process, url);
  }

  /** End it as a user does; returns its exit code. */
  stop(): Promise<number | null> {
    return new Promise((resolve) => {
      this.process.removeAllListeners("exit");
      this.process.on("exit", (code) => resolve(code));
      this.process.kill("SIGINT");
    });
  }
}

/** What opens files of a folder in one browser, each with a server of its own until the test ends. */
export function opening(
  folder: string, size: number, opened: (page: Page) => void | Promise<void>,
): (file: string, query?: string, ...options: string[]) => Promise<void> {
  let browser: Browser;
  let page: Page | null = null;
  let server: Server | null = null;

  beforeAll(async () => {
    browser = await launch();
  });
  afterAll(async () => {
    await browser?.close();
  });
  afterEach(async () => {
    await page?.close();
    await server?.stop();
    page = server = null;
  });

  return async (file, query = `&pixels=${size}x${size}`, ...options) => {
    server = await Server.start(join(folder, file), ...options);
    page = await browser.newPage({ viewport: { width: 900, height: 640 } });
    await opened(page);
    await page.goto(server.url + query);
  };
}

/** Wait until the page has come to a state; what it says of a failure is the error if it comes to that instead. */
export async function reached(page: Page, state: string): Promise<void> {
  await page.waitForFunction((wanted) => wanted.includes(document.documentElement.dataset["state"] ?? ""),
    [state, "failed"], { timeout: 90_000 });
  const found = await page.evaluate(() => document.documentElement.dataset["state"] ?? "");
  if (found !== state) {
    throw new Error(await page.getByRole("alert").textContent() ?? found);
  }
}

/** Wait until nothing more is drawn. */
export async function settled(page: Page): Promise<void> {
  for (let quiet = 0; quiet < 2;) {
    await page.waitForTimeout(100);
    quiet = await page.evaluate(() => document.querySelector("canvas")!.ariaBusy) === "false" ? quiet + 1 : 0;
  }
}

/** The canvas as it is shown, one picture pixel a screen pixel, as RGB bytes. */
export async function pixels(page: Page, size: number): Promise<Uint8Array> {
  await page.evaluate((side) => {
    const canvas = document.querySelector("canvas")!;
    Object.assign(canvas.style, { position: "fixed", left: "0", top: "0", width: `${side}px`, height: `${side}px`, zIndex: "9" });
    document.querySelectorAll<HTMLElement>("#divider, #statistics, #readout, #toggle, #error-bar, #decoding").forEach((element) => {
      element.style.visibility = "hidden";
    });
  }, size);
  await settled(page);
  const shot = PNG.sync.read(await page.screenshot({ clip: { x: 0, y: 0, width: size, height: size } }));
  return Uint8Array.from({ length: 3 * size * size }, (_, i) => shot.data[4 * Math.floor(i / 3) + (i % 3)]!);
}

/** The input or list with a label that is seen. */
export function control(page: Page, label: string): Locator {
  return page.getByLabel(label, { exact: true }).and(page.locator("input, select")).locator("visible=true").first();
}

/** Bring the controls of the page to some values. */
export async function setControls(page: Page, values: Record<string, string>): Promise<void> {
  for (const [label, value] of Object.entries(values)) {
    const found = control(page, label);
    switch (await found.evaluate((element) => (element.tagName === "SELECT" ? "select" : element.getAttribute("type")))) {
      case "select":
        await found.selectOption(value);
        break;
      case "checkbox":
        await found.setChecked(value === "true");
        break;
      default:
        await found.fill(value);
        await found.blur();
    }
  }
}

export function dropFile(page: Page, name: string, bytes: Buffer): Promise<void> {
  return page.evaluate(({ text, as }) => {
    const data = new DataTransfer();
    data.items.add(new File([Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0))], as));
    window.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true }));
  }, { text: bytes.toString("base64"), as: name });
}
