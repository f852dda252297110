/** What a file that is no `.hmk` file looks like: the twin of `hmkcta.hmkfile.lookalikes`. */

import type { Limits } from "./limits";
import { HmkError } from "./reasons";

const COMPRESS = "hmkcta compress it, or give the .hmk file that was made of it";
const SEE = "see in a browser what the server says, and where the file is";
/** First bytes as Latin-1, lower-cased, what they look like, and what to do. */
const STARTS: [start: string, what: string, advice: string][] = [
  ["\x93numpy", "a NumPy array (.npy)", COMPRESS],
  ["pk\x03\x04", "a zip archive (.npz, Zarr)", `unpack the .hmk file in it, or ${COMPRESS}`],
  ["\x89hdf\r\n\x1a\n", "HDF5 or netCDF-4", COMPRESS],
  ["\x89png\r\n\x1a\n", "a PNG picture", COMPRESS],
  ["\xff\xd8\xff", "a JPEG picture", COMPRESS],
  ["ii*\0", "a TIFF picture", COMPRESS],
  ["mm\0*", "a TIFF picture", COMPRESS],
  ["v/1\x01", "an EXR picture", COMPRESS],
  ["nrrd0", "NRRD", COMPRESS],
  ["\x1f\x8b", "a file packed by gzip", "unpack it: gunzip"],
  ["bzh", "a file packed by bzip2", "unpack it: bunzip2"],
  ["\xfd7zxz\0", "a file packed by xz", "unpack it: unxz"],
  ["\x28\xb5\x2f\xfd", "a file packed by zstd", "unpack it: unzstd"],
  ["version https://git-lfs", "a pointer of Git LFS", "fetch what it points to: git lfs pull"],
  ["<!doctype html", "a web page", SEE],
  ["<html", "a web page", SEE],
];
/** Bytes that tell all of them. */
export const START = 64;
const JSON_AT = 8; // where the JSON of a header begins

/** A file that does not begin as an `.hmk` file does: the sentence says as what. */
export class ForeignFile extends HmkError {}

/** Refuse a file of `size` bytes that begins as no `.hmk` file does; `start` are its first `START` bytes, or all. */
export function checkStart(start: Uint8Array, size: number, limits: Limits): void {
  const text = String.fromCharCode(...start.subarray(0, START));
  if (text[JSON_AT] === "{") {
    return;
  }
  const begins = text.replace(/^[ \t\n\r\v\f]+</, "<").replace(/[A-Z]/g, (letter) => letter.toLowerCase());
  // Up to eight bytes might be those of a length.
  const known = size > JSON_AT ? STARTS.find(([first]) => begins.startsWith(first)) : undefined;
  const length = [...start.subarray(0, JSON_AT)].reduceRight((sum, byte) => sum * 256 + byte, 0);
  const isLength = length <= limits.json_bytes && (size <= JSON_AT || (length > 0 && length <= size - JSON_AT));
  if (known !== undefined || !isLength) {
    const [, what, advice] = known ?? ["", "no .hmk file", "check that it is an .hmk file"];
    throw new ForeignFile("Io", "foreign-file", "header", `what begins like ${what}`, "an .hmk file", advice);
  }
}
