/** What a file that is no `.hmk` file looks like: the twin of `hmkcta.hmkfile.lookalikes`. */

import { type HmkError, fault } from "./reasons";

const COMPRESS = "hmkcta compress it, or give the .hmk file that was made of it";
const SEE = "see in a browser what the server says, and fetch the file again";
/** First bytes as Latin-1, lower-cased, what they look like, and what to do. */
const STARTS: [start: string, what: string, advice: string][] = [
  ["\x93numpy", "a NumPy array (.npy)", COMPRESS],
  ["pk\x03\x04", "a zip archive (.npz, Zarr)", `unpack the .hmk file in it, or ${COMPRESS}`],
  ["\x89hdf\r\n\x1a\n", "HDF5 or netCDF-4", COMPRESS],
  ["\x89png\r\n\x1a\n", "a PNG picture", COMPRESS],
  ["\x1f\x8b", "a file packed by gzip", "unpack it: gunzip"],
  ["version https://git-lfs", "a pointer of Git LFS", "fetch what it points to: git lfs pull"],
  ["<!doctype html", "a web page", SEE],
  ["<html", "a web page", SEE],
];
/** Bytes that tell all of them. */
export const START = 64;

/** The error of a file that does not begin as an `.hmk` file does, which says what it looks like. */
export function foreign(start: Uint8Array): HmkError {
  const text = String.fromCharCode(...start.subarray(0, START));
  const begins = (text.trimStart().startsWith("<") ? text.trimStart() : text).toLowerCase();
  const [, what, advice] = STARTS.find(([first]) => begins.startsWith(first)) ?? ["", "no .hmk file", "check that it is an .hmk file"];
  return fault("not-hmk", "header", `what begins like ${what}`, "an .hmk file", advice);
}
