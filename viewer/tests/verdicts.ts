/**
 * The TypeScript reader as a process: mutants come on standard input, what it says of each goes to standard output.
 *
 * As `tests/fuzz/python_reader.py` has it: a length in four bytes before each mutant, a line of JSON after it.
 */

// The global `process`: importing it opens standard input in a way that does not wait.
import { readSync, writeSync } from "node:fs";
import { loads } from "../src/reader/read";
import { HmkError } from "../src/reader/reasons";

/** As many bytes of standard input, or null where it ends. */
function taken(length: number): Uint8Array<ArrayBuffer> | null {
  const bytes = new Uint8Array(length);
  for (let have = 0; have < length;) {
    const count = readSync(0, bytes, have, length - have, null);
    if (count === 0) {
      return null;
    }
    have += count;
  }
  return bytes;
}

/** Seconds of the processor, as the machine may be at other work. */
function spent(): number {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1e6;
}

function peak(): number {
  return process.resourceUsage().maxRSS / 1024;
}

function answer(file: Uint8Array<ArrayBuffer>): Record<string, string | number> {
  const [before, begun] = [peak(), spent()];
  const said = { reason: "ok", kind: "", escape: "" };
  try {
    loads(file);
  } catch (error) {
    if (error instanceof HmkError) {
      [said.reason, said.kind] = [error.reason, error.kind];
    } else {
      said.escape = String(error instanceof Error ? error.stack : error).slice(0, 300);
    }
  }
  return { ...said, seconds: spent() - begun, mebibytes: peak() - before, lines: 0 };
}

for (let head = taken(4); head !== null; head = taken(4)) {
  const file = taken(new DataView(head.buffer).getUint32(0, true));
  if (file === null) {
    break;
  }
  writeSync(1, `${JSON.stringify(answer(file))}\n`);
}
