/** A file from its first byte to its last level, checked on the way, announced part by part. */

import { LENGTH_BYTES, headerLength } from "./reader/header";
import { DEFAULT_LIMITS, type Limits, ON_GPU } from "./reader/limits";
import { START, checkStart as checkFormat } from "./reader/lookalikes";
import { Reading } from "./reader/read";
import type { ByteSource } from "./stream";

/** What the viewer takes less of than other readers. */
const VIEWER_LIMITS: Limits = { ...DEFAULT_LIMITS, level_cost: ON_GPU };

interface Listener {
  onTables(reading: Reading): Promise<void> | void;
  onLevel(reading: Reading, level: number): Promise<void> | void;
}

/** Check a file up to its first level; throws as `load` does. */
export async function checkStart(source: ByteSource): Promise<void> {
  const reading = await readTables(source, VIEWER_LIMITS);
  await source.upTo(reading.levelEnd(1));
  reading.readLevel(1, source.bytes);
}

/** Read a file; throws `HmkError` or `Problem`. */
export async function load(source: ByteSource, listener: Listener, limits = VIEWER_LIMITS): Promise<Reading> {
  const reading = await readTables(source, limits);
  const levels = reading.metadata.levels.map((_, l) => l + 1);
  const fetched = (those: number[]): Promise<void>[] => fetchAhead(source, those.map((level) => reading.levelEnd(level)));
  const arrivals = fetched(levels.slice(0, 1));
  await listener.onTables(reading);
  for (const level of levels) {
    await arrivals[level - 1];
    reading.readLevel(level, source.bytes);
    await listener.onLevel(reading, level);
    if (level === 1) { // the first picture is there, which what follows would have kept waiting
      arrivals.push(...fetched(levels.slice(1)));
    }
  }
  return reading;
}

async function readTables(source: ByteSource, limits: Limits): Promise<Reading> {
  const reading = await begin(source, limits);
  await source.upTo(reading.tablesEnd);
  reading.readTables(source.bytes);
  return reading;
}

/** Read the header; what is no `.hmk` file at all is told by what it looks like. */
async function begin(source: ByteSource, limits: Limits): Promise<Reading> {
  await source.upTo(START);
  checkFormat(source.bytes.subarray(0, START), source.size, limits);
  const length = headerLength(source.bytes, source.size, limits);
  await source.upTo(LENGTH_BYTES + length);
  return new Reading(source.bytes.subarray(LENGTH_BYTES, LENGTH_BYTES + length), source.size, limits);
}

/** Fetch while shaders are compiled and pictures drawn; one promise an end, each kept when its bytes are there. */
function fetchAhead(source: ByteSource, ends: number[]): Promise<void>[] {
  let before = Promise.resolve();
  return ends.map((end) => {
    before = before.then(() => source.upTo(end));
    before.catch(() => undefined); // whoever waits for it hears of the failure
    return before;
  });
}
