/**
 * The Golomb-Rice code of a packed level's numbers (`docs/format.md`, section 3), and what these stand for.
 *
 * An array `rice/<n>` has a byte for each column of a mode's bases: the lower four bits are the parameter of the codes
 * of its numbers, the upper four the largest one of the core numbers that stand for this column. A core number, which
 * stands for a column of each mode, has the least of these.
 */

import { BitStream } from "./bitstream";
import { halfOfSteps } from "./half";
import { type HmkError, fault } from "./reasons";
import type { Find } from "./schema";
import { type Geometry, type Nodes, nameIn } from "./tables";

const MOST_ZEROS = 12; // of a code, and how many bits such a code has besides, whatever its parameter is
const OWN_BITS = 16;
const LARGEST_PARAMETER = 15;
const BELOW_ONE = 2; // a number is q / 2^(k + 2): about one at the most, as codes are short where 2^k is near most q

/** By mode: of each node [R_n]; null of an undecomposed mode. */
type Rice = (Uint8Array | null)[];

/**
 * Numbers one after the other: so many `times` one for each of the parameters from `begin` to `end`. They count steps
 * of the `largest` parameter or, where it is null, of their own.
 */
type Take = (parameters: Uint8Array, begin: number, end: number, times: number, largest: number | null) => void;
/** Tells of all numbers of an array, node after node; the parameters are there until the next call. */
type Codes = (take: Take) => void;

function riceOf(nodes: Nodes, array: Find): Rice {
  return nodes.ranks.map((_, n) => array(nameIn(nodes, `rice/${n}`)) as Uint8Array | null);
}

/**
 * Parameters, and the arrays of which nodes have so many `numbers`, `core` or `basis/<n>`, by their names.
 *
 * Unless their bytes are `there` it is only seen to it that nothing larger is made than their lengths allow: the codes
 * are looked at when the level is unpacked.
 */
export function checkPacked(
  nodes: Nodes, array: Find, numbers: Map<string, (s: number) => number>, there: boolean,
): void {
  const rice = riceOf(nodes, array);
  for (const n of nodes.decomposed) {
    checkParameters(nameIn(nodes, `rice/${n}`), rice[n]!, nodes.ranks[n]!);
  }
  for (const [name, count] of numbers) {
    const [full, stored] = [nameIn(nodes, name), array(nameIn(nodes, name)) as Uint8Array];
    let all = 0;
    for (let s = 0; s < nodes.nodes; s += 1) {
      all += count(s);
    }
    if (all > 8 * stored.length) { // no number has less than a bit
      throw fault("array-shape", full, `[${stored.length}]`, `the codes of ${all} numbers`);
    }
    if (there) {
      const n = Number(name.split("/")[1]);
      const codes = name === "core" ? codesOfCores(nodes, rice) : codesOfBases(rice[n]!, nodes.ranks[n]!, count);
      checkCodes(full, stored, codes);
    }
  }
}

/** Of a mode's columns there are as many as the nodes have ranks. */
function checkParameters(name: string, rice: Uint8Array, ranks: Uint32Array): void {
  const columns = ranks.reduce((all, each) => all + each, 0);
  if (rice.length !== columns) {
    throw fault("array-shape", name, `[${rice.length}]`, `[${columns}]`);
  }
}

/** The codes of a mode's bases, of which nodes have so many numbers. */
function codesOfBases(rice: Uint8Array, ranks: Uint32Array, numbers: (s: number) => number): Codes {
  const parameters = rice.map((each) => each & 15);
  return (take) => {
    for (let s = 0, column = 0; s < ranks.length; column += ranks[s]!, s += 1) {
      if (ranks[s]! > 0) {
        take(parameters, column, column + ranks[s]!, numbers(s) / ranks[s]!, null);
      }
    }
  };
}

/** The codes of cores: all cells of a node have the same parameters. */
function codesOfCores(nodes: Nodes, rice: Rice): Codes {
  const parameters = rice.map((each) => each?.map((both) => both >> 4) ?? null);
  let most = 0;
  for (let s = 0; s < nodes.nodes; s += 1) {
    most = Math.max(most, nodes.ranks.reduce((all, rank) => all * rank[s]!, 1));
  }
  return (take) => {
    const own = new Uint8Array(most);
    const column = new Float64Array(rice.length); // the node's first one, by mode
    for (let s = 0; s < nodes.nodes; s += 1) {
      own[0] = LARGEST_PARAMETER;
      let count = 1;
      for (const [n, each] of parameters.entries()) {
        const rank = nodes.ranks[n]![s]!;
        spread(own, count, rank, each, column[n]!);
        count *= rank;
        column[n]! += rank;
      }
      take(own, 0, count, nodes.cells[s]!, largestOf(own, count));
    }
  };
}

/** The least parameters by the indices of one mode more: in the same place, so from the last one on. */
function spread(own: Uint8Array, count: number, rank: number, parameters: Uint8Array | null, column: number): void {
  for (let at = count - 1; at >= 0; at -= 1) {
    const least = own[at]!;
    for (let r = rank - 1; r >= 0; r -= 1) {
      own[at * rank + r] = parameters === null ? least : Math.min(least, parameters[column + r]!);
    }
  }
}

function largestOf(own: Uint8Array, count: number): number {
  let largest = 0;
  for (let at = 0; at < count; at += 1) {
    largest = Math.max(largest, own[at]!);
  }
  return largest;
}

/** Check that an array holds the codes of its numbers and no more; the byte at which the second sequence begins. */
function checkCodes(name: string, stored: Uint8Array, codes: Codes): number {
  const first = new BitStream(stored);
  let bits = 0; // of the second sequence
  codes((parameters, begin, end, times) => {
    for (let time = 0; time < times; time += 1) {
      for (let i = begin; i < end; i += 1) {
        const zeros = first.zeros();
        if (zeros > MOST_ZEROS) {
          throw badCode(name, zeros, stored.length);
        }
        bits += zeros === MOST_ZEROS ? OWN_BITS : parameters[i]!;
      }
    }
  });
  const needed = first.end + Math.ceil(bits / 8);
  if (stored.length !== needed) {
    throw fault("array-shape", name, `[${stored.length}]`, `[${needed}]`);
  }
  return first.end;
}

function badCode(name: string, zeros: number, length: number): HmkError {
  return zeros < Infinity
    ? fault("code-range", name, `${zeros} bits of 0`, `at most ${MOST_ZEROS}`)
    : fault("array-shape", name, `[${length}]`, "the codes of all its numbers");
}

/** The pattern of the number of so many steps of a parameter, which are folded: 0, -1, 1, -2, .. */
function numberOf(folded: number, parameter: number): number {
  return halfOfSteps((folded >> 1) ^ -(folded & 1), parameter + BELOW_ONE);
}

const SMALL = 4096;
let table: Uint16Array | undefined;

/** The numbers of few steps, parameter after parameter: most are such, and quicker looked up than made. */
function smallNumbers(): Uint16Array {
  table ??= Uint16Array.from({ length: (LARGEST_PARAMETER + 1) * SMALL },
    (_, at) => numberOf(at % SMALL, Math.floor(at / SMALL)));
  return table;
}

/** Fill a packed level, whose tables `checkPacked` has let through, with the numbers that its codes stand for. */
export function unpackLevel(geometry: Geometry, array: Find): void {
  const { packed, ranks } = geometry;
  const rice = riceOf(geometry, array);
  const unpackArray = (name: string, codes: Codes, into: Uint16Array): void =>
    unpack(nameIn(geometry, name), array(nameIn(geometry, name)) as Uint8Array, codes, into);
  unpackArray("core", codesOfCores(geometry, rice), packed.core);
  for (const n of geometry.decomposed) {
    const offsets = packed.basisOffset[n]!;
    const codes = codesOfBases(rice[n]!, ranks[n]!, (s) => offsets[s + 1]! - offsets[s]!);
    unpackArray(`basis/${n}`, codes, packed.basis[n]!);
  }
}

function unpack(name: string, stored: Uint8Array, codes: Codes, into: Uint16Array): void {
  const second = new BitStream(stored, checkCodes(name, stored, codes));
  const first = new BitStream(stored);
  const small = smallNumbers();
  let at = 0;
  codes((parameters, begin, end, times, largest) => {
    for (let time = 0; time < times; time += 1) {
      for (let i = begin; i < end; i += 1, at += 1) {
        const parameter = parameters[i]!;
        const zeros = first.zeros();
        const folded = zeros === MOST_ZEROS ? second.next(OWN_BITS) : (zeros << parameter) | second.next(parameter);
        const steps = largest ?? parameter;
        into[at] = folded < SMALL ? small[steps * SMALL + folded]! : numberOf(folded, steps);
      }
    }
  });
}
