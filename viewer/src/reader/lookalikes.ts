/** What a file that is no `.hmk` file looks like: the twin of `hmkcta.hmkfile.lookalikes`. */

import { HmkError } from "./reasons";

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
const JSON_AT = 8; // where the JSON of a header begins

/** A file that does not begin as an `.hmk` file does: kind and reason are the format's, the sentence says so. */
export class ForeignFile extends HmkError {}

/** The error about a file's header; where the file begins as no `.hmk` file does, one that says what it looks like. */
export function recognised(error: HmkError, start: Uint8Array): HmkError {
  const text = String.fromCharCode(...start);
  if (error.where !== "header" || text[JSON_AT] === "{") {
    return error;
  }
  const begins = (text.trimStart().startsWith("<") ? text.trimStart() : text).toLowerCase();
  const known = STARTS.find(([first]) => begins.startsWith(first));
  const noLength = ["header-too-large", "truncated"].includes(error.reason) || !/[^\0]/.test(text.slice(0, JSON_AT));
  if (known === undefined && (!noLength || start.length <= JSON_AT)) {
    return error;
  }
  const [, what, advice] = known ?? ["", "no .hmk file", "check that it is an .hmk file"];
  return new ForeignFile(error.kind, error.reason, error.where, `what begins like ${what}`, "an .hmk file", advice);
}
