/** How long the page takes from navigation to the first and to the last level of a file of 22 MiB, the paper's WH4. */

import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, readdirSync, statSync } from "node:fs";
import { loadavg, tmpdir } from "node:os";
import { join } from "node:path";
import type { Browser } from "playwright-core";
import { it } from "vitest";
import { PYTHON, Server, haveBrowser, launch } from "./browser";

const RUNS = Number(process.env["RUNS"] ?? "5");
const LEVELS = 3;
const PIXELS = "128x128";
const SETTLED = 800; // milliseconds that a new window of the browser takes for itself
const MAKE = "import sys; from hmkcta.render.workload import configuration, random_model;"
  + "random_model(configuration(sys.argv[1])).save(sys.argv[2])";

/** Processor time of all Chromiums in milliseconds: what counts where others use the machine, too. */
function processorTime(): number {
  return readdirSync("/proc").filter((name) => /^\d+$/.test(name)).reduce((sum, name) => {
    try {
      const [, command = "", rest = ""] = /^\d+ \((.*)\) (.*)$/s.exec(readFileSync(`/proc/${name}/stat`, "utf-8")) ?? [];
      const fields = rest.split(" ");
      return command.startsWith("chrom") ? sum + 10 * (Number(fields[11]) + Number(fields[12])) : sum;
    } catch {
      return sum; // it has ended meanwhile
    }
  }, 0);
}

/** Milliseconds from navigation to each mark that the page leaves, and of processor time up to the last one. */
async function load(browser: Browser, url: string): Promise<Map<string, number>> {
  const page = await browser.newPage({ viewport: { width: 900, height: 640 } });
  await page.waitForTimeout(SETTLED);
  const before = processorTime();
  await page.goto(`${url}&pixels=${PIXELS}`, { waitUntil: "commit" });
  await page.waitForFunction((last) => performance.getEntriesByName(last).length > 0, `shown-level-${LEVELS}`, { polling: 50 });
  const spent = processorTime() - before;
  const marks = await page.evaluate(() => performance.getEntriesByType("mark").map(({ name, startTime }) => [name, startTime] as const));
  await page.close();
  return new Map([...marks, ["(processor time)", spent]]);
}

function median(values: number[]): number {
  return values.sort((a, b) => a - b)[Math.floor(values.length / 2)]!;
}

it.runIf(haveBrowser())("loads", async () => {
  const file = join(mkdtempSync(join(tmpdir(), "hmkcta-measure-")), "wood.hmk");
  execFileSync(PYTHON, ["-c", MAKE, process.env["CONFIGURATION"] ?? "WH4", file]);
  const server = await Server.start(file);
  const browser = await launch();
  const runs: Map<string, number>[] = [];
  for (let run = 0; run < RUNS; run += 1) {
    runs.push(await load(browser, server.url));
  }
  await browser.close();
  await server.stop();
  const names = [...runs[0]!.keys()];
  const rows = names.map((name) => `| ${name} | ${(median(runs.map((run) => run.get(name) ?? NaN)) / 1000).toFixed(2)} |`);
  console.log([`load of the machine ${loadavg()[0]!.toFixed(1)}`, `${(statSync(file).size / 1e6).toFixed(1)} MB, ${PIXELS} pixels, median of ${RUNS}`, "",
    "| mark | seconds |", "| --- | --- |", ...rows].join("\n"));
});
