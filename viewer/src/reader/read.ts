/**
 * Read a file: nothing is believed before it is checked, and no damage goes unnoticed.
 *
 * `Reading` takes the file section by section in the order of its bytes, so that level 1 can be shown while the rest is on
 * its way; `loads` does so with a whole file at hand.
 */

import { checkLargest, checkReach, largestFinite, levelReach } from "./check";
import { type Section, headerEnd, headerText, layOut, payload } from "./container";
import { parseJson } from "./json";
import { DEFAULT_LIMITS, type Limits } from "./limits";
import { type CoordSection, type Metadata, type Parsed, levelEnds, parseMetadata } from "./metadata";
import type { PackedLevel } from "./packed";
import { RunReader } from "./run";
import { Arrays } from "./stage";
import { type Stage, storedBytes } from "./stages";
import { Extents, type Nodes, rootOf } from "./tree";

export interface Model {
  metadata: Metadata;
  stages: PackedLevel[];
}

/** Read a whole file that is in memory. */
export function loads(bytes: Uint8Array<ArrayBuffer>, limits: Limits = DEFAULT_LIMITS): Model {
  const reading = new Reading(bytes, bytes.length, limits);
  while (reading.nextEnd !== null) {
    reading.readNext(bytes);
  }
  return reading;
}

/** A file on its way: its header is there and checked, its sections come later. */
export class Reading {
  readonly metadata: Metadata;
  /** The stages that are read. */
  readonly stages: PackedLevel[] = [];
  private readonly parsed: Parsed;
  private readonly sections: Section[];
  private readonly ends: number[]; // stages of each level, with those before
  private read = 0; // sections
  private readonly extents = new Extents();
  private runs: RunReader | null = null; // while there are any
  private nodes: Nodes; // of the stage at hand
  private arrays: Arrays | null = null;
  private run = 0; // of the stage at hand
  private reach = 0;

  /** `file`: its memory, filled up to `headerEnd` at least. */
  constructor(file: Uint8Array, readonly size: number, private readonly limits: Limits = DEFAULT_LIMITS) {
    const end = headerEnd(file, size, limits);
    this.parsed = parseMetadata(parseJson(headerText(file, end), "header"), size, limits);
    const { metadata, stages, coords } = this.parsed;
    this.metadata = metadata;
    this.sections = layOut(end, [...coords.map(coordLength), ...stages.flatMap(runLengths)], size);
    this.ends = levelEnds(metadata);
    const axisSizes = new Map(metadata.axes.map((axis) => [axis.name, axis.size]));
    this.nodes = rootOf(metadata.organisation.map((mode) => mode.map((name) => axisSizes.get(name)!)), this.extents);
  }

  /** Levels that are read. */
  get arrived(): number {
    return this.ends.filter((end) => end <= this.stages.length).length;
  }

  /** Bytes from the start of the file after which the next section is there; null once all are read. */
  get nextEnd(): number | null {
    return this.sections[this.read]?.end ?? null;
  }

  /** Bytes from the start of the file after which a level and all before it are there. */
  levelEnd(level: number): number {
    const runs = this.parsed.stages.slice(0, this.ends[level - 1]).reduce((sum, stage) => sum + stage.runs.length, 0);
    return this.sections[this.parsed.coords.length + runs - 1]!.end;
  }

  /** Read the next section, whose bytes must be there. */
  readNext(file: Uint8Array<ArrayBuffer>): void {
    const section = this.sections[this.read]!;
    const bytes = payload(file, section);
    const coords = this.parsed.coords[this.read];
    this.read += 1;
    if (coords !== undefined) {
      this.readCoordinates(coords, bytes, section.name);
    } else {
      this.readRun(bytes, section.name);
    }
  }

  private readCoordinates({ axis, dtype, width }: CoordSection, bytes: Uint8Array, where: string): void {
    const { buffer } = bytes.slice(); // at a place where numbers may begin
    const values = dtype === "F32" ? new Float32Array(buffer) : new Float64Array(buffer);
    largestFinite(values, where);
    this.metadata.axes[axis]!.coords = { values, width };
  }

  private readRun(bytes: Uint8Array, where: string): void {
    this.arrays ??= this.begin();
    const { stage } = this.arrays;
    const run = stage.runs[this.run]!;
    this.arrays.begin(run, where);
    this.runs ??= new RunReader(this.metadata.modeSizes.length, this.extents, this.limits);
    this.runs.read(this.arrays, bytes.subarray(0, run.bytes), run.nodes, where);
    this.arrays.end();
    if (stage.isHalf) {
      this.arrays.fill(bytes.subarray(run.bytes), run);
    }
    this.run += 1;
    while (this.arrays !== null && this.run === this.arrays.stage.runs.length) {
      this.finish(this.arrays);
      const next = this.parsed.stages[this.stages.length];
      this.arrays = next?.runs.length === 0 ? this.begin() : null; // a stage without nodes has no sections
      this.runs = next === undefined ? null : this.runs;
    }
  }

  /** Begin with the next stage. */
  private begin(): Arrays {
    const t = this.stages.length;
    const { stages } = this.parsed;
    this.run = 0;
    return new Arrays(stages[t]!, this.nodes, stages[t + 1] ?? null, `stages[${t}]`);
  }

  private finish(arrays: Arrays): void {
    const { level, stage, where } = arrays;
    this.nodes = arrays.finish() ?? this.nodes;
    checkLargest(level, stage, where);
    this.reach += levelReach(level, where);
    checkReach(this.reach, where);
    this.stages.push(level);
  }
}

function coordLength({ axis, dtype, numbers }: CoordSection): [string, number] {
  return [`axes[${axis}].coordinates`, numbers * (dtype === "F32" ? 4 : 8)];
}

function runLengths(stage: Stage, t: number): [string, number][] {
  return stage.runs.map((run, i) => [`stages[${t}].runs[${i}]`, run.bytes + storedBytes(stage, run)]);
}
