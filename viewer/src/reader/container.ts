/** The frame of a file: what it begins with, the header's bytes, and the sections behind it. */

import { crc32 } from "./digests";
import type { Limits } from "./limits";
import { foreign } from "./lookalikes";
import { fault } from "./reasons";

const MAGIC = Uint8Array.of(0x89, 0x48, 0x4d, 0x4b, 0x0d, 0x0a, 0x1a, 0x0a);
const VERSION = 1;
/** Bytes before the header: magic, version, and length and checksum of the header. */
export const PREFIX_BYTES = MAGIC.length + 12;
/** Bytes of a section's checksum, which ends it. */
export const CHECKSUM_BYTES = 4;
const REFETCH = "fetch the file again";

/** Where the header of a file of `size` bytes ends, of which the first `START` are there, or all if it has fewer. */
export function headerEnd(start: Uint8Array, size: number, limits: Limits): number {
  if (!MAGIC.subarray(0, size).every((byte, at) => start[at] === byte)) {
    throw foreign(start.subarray(0, size));
  }
  if (size < PREFIX_BYTES) {
    throw fault("truncated", "header", `a file of ${size} bytes`, `${PREFIX_BYTES} bytes and more`,
      "if it was longer where it comes from, fetch it again");
  }
  const words = viewOf(start);
  const version = words.getUint32(MAGIC.length, true);
  if (version !== VERSION) {
    throw fault("version-unknown", "header", version, VERSION, "use a viewer that is as new as the file");
  }
  const length = words.getUint32(MAGIC.length + 4, true);
  if (length > limits.json_bytes) {
    throw fault("header-too-large", "header", `${length} bytes`, `at most ${limits.json_bytes}`, "check that it is an .hmk file");
  }
  if (PREFIX_BYTES + length > size) {
    throw fault("truncated", "header", `a file of ${size} bytes`, `a header up to byte ${PREFIX_BYTES + length}`, REFETCH);
  }
  return PREFIX_BYTES + length;
}

/** The text of the header, which ends at `end`. */
export function headerText(file: Uint8Array, end: number): string {
  const bytes = file.subarray(PREFIX_BYTES, end);
  const stated = viewOf(file).getUint32(MAGIC.length + 8, true);
  checkSum("header-crc", "header", bytes, stated);
  checkBytes(bytes);
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    throw fault("json-encoding", "header", "other bytes", "UTF-8");
  }
}

/** No control characters, and lower-case digits in escapes: so there is one way to write what the header says. */
function checkBytes(bytes: Uint8Array): void {
  const allowed = "no control characters, lower-case digits in \\u escapes";
  const control = bytes.findIndex((byte) => byte < 32);
  if (control >= 0) {
    throw fault("header-bytes", "header", `byte ${bytes[control]} at ${PREFIX_BYTES + control}`, allowed);
  }
  const found = /(?<!\\)(?:\\\\)*\\u[0-9a-fA-F]{0,3}[A-F]/.exec(new TextDecoder("latin1").decode(bytes));
  if (found !== null) {
    throw fault("header-bytes", "header", `${found[0]} at byte ${PREFIX_BYTES + found.index}`, allowed);
  }
}

/** A section of a file: its payload, and behind that the checksum, at `end` - 4. */
export interface Section {
  name: string;
  begin: number;
  end: number;
}

/** The sections from the end of the header to the last byte of the file, by their names and lengths without the checksum. */
export function layOut(begin: number, lengths: [name: string, bytes: number][], size: number): Section[] {
  let at = begin;
  const sections = lengths.map(([name, bytes]): Section => {
    const section = { name, begin: at, end: at + bytes + CHECKSUM_BYTES };
    at = section.end;
    return section;
  });
  if (at > size) {
    throw fault("truncated", "data", `a file of ${size} bytes`, `${at} bytes`, REFETCH);
  }
  if (at < size) {
    throw fault("trailing-bytes", "data", `a file of ${size} bytes`, `${at} bytes`);
  }
  return sections;
}

/** The payload of a section, compared with its checksum. */
export function payload(file: Uint8Array, { name, begin, end }: Section): Uint8Array {
  const bytes = file.subarray(begin, end - CHECKSUM_BYTES);
  checkSum("section-crc", name, bytes, viewOf(file).getUint32(end - CHECKSUM_BYTES, true));
  return bytes;
}

function checkSum(reason: "header-crc" | "section-crc", where: string, bytes: Uint8Array, stated: number): void {
  const found = crc32(bytes);
  if (found !== stated) {
    throw fault(reason, where, `bytes whose checksum (CRC-32) is ${hexadecimal(found)}`, `${hexadecimal(stated)}, as the file says`, REFETCH);
  }
}

function hexadecimal(crc: number): string {
  return `0x${crc.toString(16).padStart(8, "0")}`;
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
}
