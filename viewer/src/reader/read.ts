/**
 * Read a file: nothing is believed before it is checked, and no damage goes unnoticed.
 *
 * `Reading` takes the file in the order of its bytes, so that level 1 can be shown while the rest is on its way:
 * header, tables, then core and basis numbers level by level. `loads` does the same with a whole file at hand, in the
 * order of checks that `docs/format.md`, section 8, fixes for all readers.
 */

import { checkReach, checkTables, largestFinite, levelReach } from "./check";
import { crc32 } from "./digests";
import { type Header, LENGTH_BYTES, headerLength, parseHeader } from "./header";
import { parseJson } from "./json";
import { DEFAULT_LIMITS, type Limits } from "./limits";
import { START, checkStart } from "./lookalikes";
import { type Coords, type Metadata, type Parsed, isShort, parseMetadata } from "./metadata";
import type { PackedLevel } from "./packed";
import { fault } from "./reasons";
import {
  type Find, checkOrder, checkRecords, checkSchema, isNumbers, levelOf, viewOf, widenLevel,
} from "./schema";
import { completed } from "./short";
import type { Geometry } from "./tables";

export interface Model {
  metadata: Metadata;
  levels: PackedLevel[];
}

/** Read a whole file that is in memory; its arrays become views of `bytes`, but for numbers that are widened. */
export function loads(bytes: Uint8Array<ArrayBuffer>, limits: Limits = DEFAULT_LIMITS): Model {
  checkStart(bytes.subarray(0, START), bytes.length, limits);
  const length = headerLength(bytes, bytes.length, limits);
  const reading = new Reading(bytes.subarray(LENGTH_BYTES, LENGTH_BYTES + length), bytes.length, limits);
  const aligned = bytes.byteOffset % 8 === 0 ? bytes : bytes.slice();
  reading.verify(aligned, [...reading.header.entries.keys()]);
  reading.readTables(aligned, true);
  for (let level = 1; level <= reading.metadata.levels.length; level += 1) {
    reading.readLevel(level, aligned, false);
  }
  return { metadata: reading.metadata, levels: reading.levels };
}

/** A file on its way: its header is there and checked, its arrays come later. */
export class Reading {
  readonly header: Header;
  readonly metadata: Metadata;
  levels: PackedLevel[] = [];
  private readonly parsed: Parsed;
  private geometries: Geometry[] = [];
  private reach = 0;

  constructor(raw: Uint8Array, readonly size: number, limits: Limits = DEFAULT_LIMITS) {
    this.header = parseHeader(raw, size, limits);
    this.parsed = parseMetadata(parseJson(this.header.text, "hmkcta"), limits);
    this.metadata = this.parsed.metadata;
    checkRecords(this.parsed.records, this.header.entries);
    checkSchema(this.parsed, this.header.entries, limits);
    checkOrder(this.header.entries);
  }

  /** Bytes from the start of the file after which all tables are there. */
  get tablesEnd(): number {
    return this.endOf((name) => !isNumbers(name));
  }

  /** Bytes from the start of the file after which a level and all before it are there. */
  levelEnd(level: number): number {
    return this.endOf((name) => !isNumbers(name) || Number(name.split("/")[1]) <= level);
  }

  private endOf(wanted: (name: string) => boolean): number {
    let end = 0;
    for (const [name, entry] of this.header.entries) {
      end = wanted(name) ? Math.max(end, entry.end) : end;
    }
    return this.header.dataStart + end;
  }

  /** Compare the checksums of some arrays. */
  verify(file: Uint8Array<ArrayBuffer>, names: string[]): void {
    for (const name of names) {
      const entry = this.header.entries.get(name);
      const record = this.parsed.records.get(name);
      if (entry === undefined || record === undefined) {
        continue;
      }
      const start = this.header.dataStart;
      const found = crc32(file.subarray(start + entry.begin, start + entry.end));
      if (found !== record.crc32) {
        throw fault("array-crc", name, `stored bytes whose checksum (CRC-32) is ${hexadecimal(found)}`,
          `${hexadecimal(record.crc32)}, as the metadata say`, "fetch the file again");
      }
    }
  }

  /**
   * Check all tables; `file` is the memory of the whole file, filled at least up to `tablesEnd`.
   *
   * Where all of it is `there`, and compared with its checksums, the codes of packed levels are checked with them, as
   * the order of checks has it; else not before `readLevel`.
   */
  readTables(file: Uint8Array<ArrayBuffer>, there = false): void {
    if (!there) {
      this.verify(file, this.names((name) => !isNumbers(name)));
    }
    const array = this.arraysIn(file);
    for (const [n, name] of this.parsed.coords) {
      const values = array(name) as Coords["values"];
      largestFinite(values, name);
      this.metadata.axes[n]!.coords = { values, width: this.header.entries.get(name)?.shape[1] ?? 0 };
    }
    const order = this.metadata.modeSizes.length;
    const whole = isShort(this.parsed.version) ? completed(array, this.metadata, there) : array;
    this.levels = this.metadata.levels.map((_, l) => levelOf(whole, l + 1, order));
    this.geometries = checkTables(this.metadata, this.levels);
  }

  /** Check the core and basis numbers of a level, in order from level 1; its bytes must be there. */
  readLevel(level: number, file: Uint8Array<ArrayBuffer>, verify = true): void {
    if (verify) {
      this.verify(file, this.names((name) => isNumbers(name) && name.startsWith(`level/${level}/`)));
    }
    const geometry = this.geometries[level - 1]!;
    widenLevel(geometry, this.arraysIn(file));
    this.reach += levelReach(geometry);
    checkReach(this.reach, geometry);
  }

  private arraysIn(file: Uint8Array<ArrayBuffer>): Find {
    return (name) => {
      const entry = this.header.entries.get(name);
      return entry === undefined ? null : viewOf(file, this.header.dataStart, entry);
    };
  }

  private names(wanted: (name: string) => boolean): string[] {
    return [...this.header.entries.keys()].filter(wanted);
  }
}

function hexadecimal(crc: number): string {
  return `0x${crc.toString(16).padStart(8, "0")}`;
}
