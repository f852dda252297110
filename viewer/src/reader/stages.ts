/** What the header says of the stages: how much their runs hold, which bounds all that is made of them. */

import { asInteger, asList, asNumber, asObject, asOneOf } from "./fields";
import { type Json, Real } from "./json";
import { type Limits, checkLimit } from "./limits";
import { fault } from "./reasons";

const SCHEMES = ["none", "most", "least", "uniform"] as const;
export const MAX_U32 = 2 ** 32 - 1;

/** The largest C, K, R of any node of a stage. */
export interface LevelBounds {
  clusters: number[];
  mixture: number[];
  ranks: number[];
  scheme: string;
}

/** A section of codes: how many nodes, bytes and numbers it has. */
export interface Run {
  nodes: number;
  bytes: number; // of the code alone
  cells: number;
  core: number;
  basis: number[]; // by mode
}

export interface Stage extends LevelBounds {
  nodes: number;
  step: number | null; // of coded numbers
  isHalf: boolean; // whether numbers are float16
  rows: number[]; // of all nodes, by mode
  runs: Run[];
}

/** Whether nodes of a stage add numbers; the others lead on to the next stage. */
export function hasNumbers({ step, isHalf }: Stage): boolean {
  return step !== null || isHalf;
}

/** Whether the largest shapes are those of cuts. */
function isCut({ clusters, ranks }: LevelBounds): boolean {
  return clusters.some((each) => each > 0) && !ranks.some((each) => each > 0);
}

/** Bytes of a run's numbers that are stored as they are. */
export function storedBytes({ isHalf }: Stage, { cells, core, basis }: Run): number {
  return isHalf ? 4 * cells + 2 * basis.reduce((all, each) => all + each, core) : 0;
}

/** The sum of something over the runs of a stage. */
export function total({ runs }: Stage, count: (run: Run) => number): number {
  return runs.reduce((sum, run) => sum + count(run), 0);
}

/** Check the stages of a file of `size` bytes. */
export function parseStages(value: Json, where: string, sizes: number[], size: number, limits: Limits): Stage[] {
  const items = asList(value, where);
  checkLimit("levels-limit", where, items.length, limits.levels);
  const stages = items.map((item, t) => parseStage(item, `${where}[${t}]`, sizes, limits));
  const last = stages.at(-1);
  if (last === undefined || !hasNumbers(last)) {
    throw fault("field-value", where, last === undefined ? "no stages" : "a last stage without numbers", "a last stage with numbers");
  }
  const [root] = stages as [Stage];
  if (root.nodes !== 1) {
    throw fault("field-value", `${where}[0].nodes`, root.nodes, "1, the root");
  }
  if (root.rows.join() !== sizes.join()) {
    throw fault("row-count", `${where}[0].rows`, root.rows.join(), `${sizes.join()}, the sizes of the modes`);
  }
  checkLimit("nodes-limit", where, stages.reduce((sum, { nodes }) => sum + nodes, 0), limits.nodes);
  const bytes = stages.reduce((sum, stage, t) => sum + widenedBytes(stage, t === stages.length - 1), 0);
  const most = limits.widened + 64 * size;
  if (bytes > most) {
    throw fault("widened-limit", where, `${Math.ceil(bytes / 2 ** 20)} MiB of memory`,
      `at most ${Math.floor(most / 2 ** 20)} MiB for a file of ${size} bytes`, `if you trust the file, open it with the limit widened: ${bytes - 64 * size}`);
  }
  return stages;
}

function parseStage(value: Json, where: string, sizes: number[], limits: Limits): Stage {
  const fields = asObject(value, where, ["nodes", "largest", "rows", "runs"], ["step", "bits", "scheme"]);
  const order = sizes.length;
  const counts = (item: Json, path: string): number[] => asList(item, path, order).map((each) => asInteger(each, path, 0, MAX_U32));
  const [clusters, mixture, ranks] = asList(fields.largest, `${where}.largest`, 3).map((each) => counts(each, `${where}.largest`)) as
    [number[], number[], number[]];
  const stage: Stage = {
    clusters, mixture, ranks, nodes: asInteger(fields.nodes, `${where}.nodes`, 0, MAX_U32),
    step: fields.step === undefined ? null : parseStep(fields.step, `${where}.step`),
    isHalf: fields.bits !== undefined && asInteger(fields.bits, `${where}.bits`, 16, 16) === 16,
    scheme: fields.scheme === undefined ? "none" : asOneOf(fields.scheme, `${where}.scheme`, SCHEMES),
    rows: counts(fields.rows, `${where}.rows`),
    runs: asList(fields.runs, `${where}.runs`).map((run, i) => parseRun(run, `${where}.runs[${i}]`, order)),
  };
  checkBounds(stage, where, sizes, limits);
  checkTotals(stage, where);
  return stage;
}

function parseStep(value: Json, where: string): number {
  const step = Math.fround(asNumber(value, where, 0));
  if (step === 0 || step === Infinity) {
    throw fault("field-value", where, value instanceof Real ? value.value : "0", "a float32 number above 0");
  }
  return step;
}

function parseRun(value: Json, where: string, order: number): Run {
  const [nodes, bytes, cells, core, ...basis] = asList(value, where, 4 + order).map((item) => asInteger(item, where, 0, MAX_U32));
  return { nodes: nodes!, bytes: bytes!, cells: cells!, core: core!, basis };
}

/** Limits of a stage; its nodes are held against these bounds later, and what holds in decomposed modes alone is checked then. */
function checkBounds(stage: Stage, where: string, sizes: number[], limits: Limits): void {
  const path = `${where}.largest`;
  if (stage.step !== null && stage.isHalf) {
    throw fault("field-value", `${where}.bits`, "bits and a step", "one of them");
  }
  if (hasNumbers(stage) === isCut(stage) || (!hasNumbers(stage) && stage.mixture.some((each) => each > 0))) {
    const found = [stage.clusters, stage.mixture, stage.ranks].map((each) => `[${each.join()}]`).join();
    throw fault("field-value", path, `[${found}]`, "C > 0 = K = R if and only if there is neither step nor bits");
  }
  sizes.forEach((size, n) => {
    checkLimit("clusters-limit", path, stage.clusters[n]!, limits.clusters);
    checkLimit("mixture-limit", path, stage.mixture[n]!, limits.mixture);
    checkLimit("rank-limit", path, stage.ranks[n]!, stage.mixture[n] === 0 ? size : Math.max(size, limits.rank));
  });
}

/** What the runs hold together must be what the stage does, and few enough to be counted. */
function checkTotals(stage: Stage, where: string): void {
  const nodes = total(stage, (run) => run.nodes);
  if (nodes !== stage.nodes || stage.runs.some((run) => run.nodes === 0)) {
    throw fault("field-value", `${where}.runs`, `${nodes} nodes`, `${stage.nodes}, one at least in each run`);
  }
  const counts = [(run: Run) => run.cells, (run: Run) => run.core, ...stage.rows.map((_, n) => (run: Run) => run.basis[n]!)];
  for (const count of counts) {
    const sum = total(stage, count);
    if (sum > MAX_U32 || (sum > 0 && !hasNumbers(stage))) {
      throw fault("field-value", `${where}.runs`, `${sum} cells or numbers`, hasNumbers(stage) ? `at most ${MAX_U32}` : "none");
    }
  }
}

/** Bytes of the arrays of a stage. */
function widenedBytes(stage: Stage, isLast: boolean): number {
  const order = stage.rows.length;
  const basis = stage.rows.map((_, n) => total(stage, (run) => run.basis[n]!));
  const entries = basis.map((count, n) => Math.min(count, stage.rows[n]! * stage.mixture[n]!));
  const rows = stage.rows.reduce((all, each) => all + each, 0);
  const sum = (counts: number[]): number => counts.reduce((all, each) => all + each, 0);
  return 4 * stage.nodes * (3 + 8 * order) + 4 * total(stage, (run) => run.cells)
    + 2 * (total(stage, (run) => run.core) + sum(basis) + sum(entries)) + (isLast ? 0 : 6 * rows);
}
