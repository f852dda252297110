/** What a file that is no `.hmk` file looks like: the twin of `hmkcta.hmkfile.lookalikes`. */

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

/** A file that does not begin as an `.hmk` file does: the sentence says as what. */
export class ForeignFile extends HmkError {}

/** The error of a file that does not begin as an `.hmk` file does; `start` are its first `START` bytes, or all. */
export function foreign(start: Uint8Array): ForeignFile {
  const text = String.fromCharCode(...start.subarray(0, START));
  const begins = text.replace(/^[ \t\n\r\v\f]+</, "<").replace(/[A-Z]/g, (letter) => letter.toLowerCase());
  // Of safetensors there is a JSON object behind its length.
  const other = text[8] === "{" ? "safetensors" : "no .hmk file";
  const [, what, advice] = STARTS.find(([first]) => begins.startsWith(first)) ?? ["", other, "check that it is an .hmk file"];
  return new ForeignFile("Io", "foreign-file", "header", `what begins like ${what}`, "an .hmk file", advice);
}
