/** A file from its first byte to its last level, checked on the way, announced level by level. */

import { headerEnd } from "./reader/container";
import { DEFAULT_LIMITS, type Limits, ON_GPU } from "./reader/limits";
import { START } from "./reader/lookalikes";
import { Reading } from "./reader/read";
import type { ByteSource } from "./stream";

/** What the viewer takes less of than other readers. */
const VIEWER_LIMITS: Limits = { ...DEFAULT_LIMITS, level_cost: ON_GPU };
const LITTLE = 512 * 1024; // bytes behind level 1 that are read before it is shown, for they take no longer than a shader
const SOON = 100; // milliseconds in which they must be there
const BREATH = 25; // milliseconds of reading after which the page may do something else

interface Listener {
  /** Level 1 is read, perhaps with others; more are told of later. */
  onStart(reading: Reading): Promise<void> | void;
  onLevel(reading: Reading, level: number): Promise<void> | void;
}

/** Check a file up to its first level; throws as `load` does. */
export async function checkStart(source: ByteSource): Promise<void> {
  const reading = await begin(source, VIEWER_LIMITS);
  await readLevel(source, reading, 1);
}

/** Read a file; throws `HmkError` or `Problem`. Nothing behind a level that is told of is read until the listener is done with it. */
export async function load(source: ByteSource, listener: Listener, limits = VIEWER_LIMITS): Promise<Reading> {
  const reading = await begin(source, limits);
  const levels = reading.metadata.levels.length;
  const first = reading.levelEnd(1);
  const little = source.size - first <= LITTLE;
  expect(source, little ? source.size : first);
  await readLevel(source, reading, 1);
  const failed = little && await arrived(source) ? await failure(() => readLevel(source, reading, levels)) : null;
  await listener.onStart(reading);
  for (let level = 1; level <= levels; level += 1) {
    if (failed !== null && level > reading.arrived) {
      throw failed.error;
    }
    await readLevel(source, reading, level);
    await listener.onLevel(reading, level);
    expect(source, source.size); // the first picture is there, which what follows would have kept waiting
  }
  return reading;
}

async function begin(source: ByteSource, limits: Limits): Promise<Reading> {
  await source.upTo(START); // or less, if the file has less
  await source.upTo(headerEnd(source.bytes, source.size, limits));
  return new Reading(source.bytes, source.size, limits);
}

/** Read up to a level, as its sections arrive. */
async function readLevel(source: ByteSource, reading: Reading, level: number): Promise<void> {
  let since = performance.now();
  while (reading.arrived < level) {
    await source.upTo(reading.nextEnd!);
    reading.readNext(source.bytes);
    if (performance.now() - since > BREATH) {
      await new Promise((resolve) => setTimeout(resolve));
      since = performance.now();
    }
  }
}

/** Have bytes fetched while something else is done; whoever waits for them hears of a failure. */
function expect(source: ByteSource, end: number): void {
  source.upTo(end).catch(() => undefined);
}

/** Whether the whole file is there soon. */
async function arrived(source: ByteSource): Promise<boolean> {
  const soon = new Promise((resolve) => setTimeout(resolve, SOON));
  await Promise.race([source.upTo(source.size).catch(() => undefined), soon]);
  return source.have === source.size;
}

async function failure(attempt: () => Promise<void>): Promise<{ error: unknown } | null> {
  try {
    await attempt();
    return null;
  } catch (error) {
    return { error };
  }
}
