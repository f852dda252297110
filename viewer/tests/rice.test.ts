/** The codes of packed levels against those of an encoder of strings of 0 and 1; arrays that hold no such codes. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { crc32 } from "node:zlib";
import { describe, expect, it } from "vitest";
import { BitStream } from "../src/reader/bitstream";
import {
  Level, arrayOf, bytesOf, codeOf, digits, drawn, draws, nearest, refusal, unpacked, wholeNumbers,
} from "./riceCode";

const PARAMETERS = Array.from({ length: 16 }, (_, k) => k);

describe("codes", () => {
  it("are those of the specification's example", () => {
    const text = readFileSync(join(import.meta.dirname, "..", "..", "docs", "format.md"), "utf-8");
    const found = new RegExp("columns of parameters (\\d and \\d) and the numbers ([-\\d., ]+) of two rows of a basis "
      + "are q = ([-\\d, ]+), that is .*? the first sequence is `([01 ]+)`, .*?, `([01 ]+)`; the bytes (.*?)\\.")
      .exec(text.replaceAll(/\s+/g, " "))!;
    const [ks, numbers, whole, bytes] = [1, 2, 3, 6].map((group) => found[group]!.split(/, | and /).map(Number)) as
      [number[], number[], number[], number[]];
    const each = [...ks, ...ks];
    const codes = whole.map((number, at) => codeOf(number, each[at]!));
    expect(codes.map(([first]) => first).join(" ")).toBe(found[4]);
    expect(codes.map(([, second]) => second).filter((second) => second !== "").join(" ")).toBe(found[5]);
    expect(arrayOf(whole, each)).toEqual(bytes);
    expect(bytes).toEqual([0x14, 0x81, 0x02]);
    expect(unpacked(ks, [0, 0], whole).basis).toEqual(numbers.map(nearest));
  });

  it("are of any bits one after the other", () => {
    const draw = draws(1);
    for (let round = 0; round < 300; round += 1) {
      const zeros = Array.from({ length: 1 + draw(40) }, () => draw(draw(8) === 0 ? 70 : 13));
      const numbers = zeros.map(() => ({ bits: draw(17), all: draw(2 ** 16) }));
      const first = bytesOf(zeros.map((each) => `${"0".repeat(each)}1`).join(""), "0");
      const second = bytesOf(numbers.map(({ bits, all }) => digits(all, bits)).join(""), "1");
      const stream = new BitStream(Uint8Array.from(first));
      expect(zeros.map(() => stream.zeros())).toEqual(zeros);
      expect(stream.end).toBe(first.length);
      expect(stream.zeros()).toBe(Infinity);
      const rest = new BitStream(Uint8Array.from([...first, ...second]), first.length);
      expect(numbers.map(({ bits }) => rest.next(bits))).toEqual(numbers.map(({ bits, all }) => all % 2 ** bits));
      expect(rest.end).toBe(first.length + second.length);
    }
  });

  it.each(PARAMETERS)("of a basis are of steps of the parameter of the column: %i", (k) => {
    const draw = draws(k);
    const whole = Array.from({ length: 3000 }, (_, at) => drawn(draw, at % 3 === 1 ? 3 : k));
    const steps = whole.map((number, at) => nearest(number / 2 ** (2 + (at % 3 === 1 ? 3 : k))));
    expect(unpacked([k, 3, k], [0, 0, 0], whole).basis).toEqual(steps);
  });

  it.each(PARAMETERS)("of a core are of steps of the largest parameter: at most %i", (largest) => {
    const draw = draws(largest);
    for (let k = 0; k <= largest; k += 1) {
      const whole = Array.from({ length: 2000 }, (_, at) => drawn(draw, at % 2 === 0 ? k : largest));
      const steps = whole.map((number) => nearest(number / 2 ** (largest + 2)));
      expect(unpacked([k << 4, largest << 4], whole, [0, 0]).core).toEqual(steps);
    }
  });

  // n = max(2**15, 6 * 2**k); crc32((np.arange(-n, n) / 2.0 ** (k + 2)).astype("<f2").tobytes())
  it.each([
    1120796232, 3456761860, 1811178103, 3967045537, 2252031398, 3964957948, 2960761488, 2763393719,
    2707386251, 896914331, 742534427, 2956933139, 2905052629, 73301540, 3014095060, 2974246502,
  ].map((checksum, k) => [k, checksum]))("are of all numbers, which are NumPy's: parameter %i", (k, checksum) => {
    const { core, basis } = unpacked([17 * k!], wholeNumbers(k!), wholeNumbers(k!));
    for (const numbers of [core, basis]) {
      expect(crc32(new Uint8Array(Uint16Array.from(numbers).buffer))).toBe(checksum);
    }
  });

  it("of 12 bits of 0 have 16 bits, whatever these are", () => {
    const second = [0, 1, 2, 0xffff].map((z) => digits(z, 16)).join("");
    const basis = Uint8Array.from([...bytesOf(`${"0".repeat(12)}1`.repeat(4), "1"), ...bytesOf(second, "1")]);
    const arrays = { "rice/0": Uint8Array.of(15), core: Uint8Array.of(1), "basis/0": basis };
    const { basis: found } = new Level(arrays, [1], [1], [4]);
    expect(Array.from(found)).toEqual([0, -1, 1, -32768].map((q) => nearest(q / 2 ** 17)));
  });
});

describe("of the arrays of a packed level", () => {
  it("there may be none", () => {
    const none = { "rice/0": new Uint8Array(0), core: new Uint8Array(0), "basis/0": new Uint8Array(0) };
    for (const nodes of [[], [0], [0, 0, 0]]) {
      expect(new Level(none, nodes, nodes, nodes).core).toHaveLength(0);
      for (const name of ["core", "basis/0", "rice/0"]) {
        expect(refusal(() => new Level({ ...none, [name]: Uint8Array.of(1) }, nodes, nodes, nodes)))
          .toBe(`array-shape level/1/${name}`);
      }
    }
  });

  it("nodes of shape zero have no part", () => {
    const arrays = {
      "rice/0": Uint8Array.of(0x10, 0x23, 0x01), core: Uint8Array.from(arrayOf([1, 2, 3, -4, 5], [1, 2, 1, 2, 0])),
      "basis/0": Uint8Array.from(arrayOf([1, -2, 300], [0, 3, 1])),
    };
    const level = new Level(arrays, [0, 2, 0, 0, 1, 0], [0, 2, 0, 0, 1, 0], [0, 1, 0, 0, 1, 0]);
    expect(Array.from(level.core)).toEqual([1 / 16, 2 / 16, 3 / 16, -4 / 16, 5 / 4].map(nearest));
    expect(Array.from(level.basis)).toEqual([1 / 4, -2 / 32, 300 / 8].map(nearest));
  });

  it("any that are too short or too long are refused", () => {
    const draw = draws(3);
    for (let round = 0; round < 40; round += 1) {
      const rice = Array.from({ length: 1 + draw(3) }, () => draw(16));
      const ks = Array.from({ length: rice.length * (1 + draw(6)) }, (_, at) => rice[at % rice.length]!);
      const whole = arrayOf(ks.map((k) => drawn(draw, k)), ks, String(draw(2)));
      const core = Uint8Array.from(arrayOf(rice, rice.map(() => 0))); // any numbers
      const read = (basis: number[]): string => refusal(() => new Level(
        { "rice/0": Uint8Array.from(rice), core, "basis/0": Uint8Array.from(basis) },
        [rice.length], [1], [ks.length / rice.length]));
      expect(read(whole)).toBe("ok");
      for (let size = 0; size < whole.length; size += 1) {
        expect(read(whole.slice(0, size))).toBe("array-shape level/1/basis/0");
      }
      for (const byte of [0, 1, 0x80, 0xff]) {
        expect(read([...whole, byte])).toBe("array-shape level/1/basis/0");
      }
    }
  });

  it("codes of too many bits of 0 are refused", () => {
    const read = (first: string, second: number[] = []): string => refusal(() => new Level({
      "rice/0": Uint8Array.of(0), core: Uint8Array.of(1),
      "basis/0": Uint8Array.from([...bytesOf(first, "0"), ...second]),
    }, [1], [1], [2]));
    expect(read(`1${"0".repeat(12)}1`, [5, 0])).toBe("ok");
    for (const zeros of [13, 14, 16, 24, 31, 32, 33, 64, 999]) {
      expect(read(`1${"0".repeat(zeros)}1`)).toBe("code-range level/1/basis/0");
      expect(read(`${"0".repeat(zeros)}11`)).toBe("code-range level/1/basis/0");
      expect(read(`1${"0".repeat(zeros)}`)).toBe("array-shape level/1/basis/0");
    }
  });

  it("any bytes are read or refused", () => {
    const draw = draws(5);
    const found = new Set<string>();
    for (let round = 0; round < 3000; round += 1) {
      const rank = 1 + draw(4);
      const bytes = (length: number, ones: number): Uint8Array =>
        Uint8Array.from({ length }, () => (draw(2) < ones ? draw(256) : 0));
      const arrays = { "rice/0": bytes(rank, 1), core: bytes(draw(16), draw(3)), "basis/0": bytes(draw(16), draw(3)) };
      found.add(refusal(() => new Level(arrays, [rank], [1 + draw(6)], [1 + draw(6)])).split(" ")[0]!);
    }
    expect([...found].sort()).toEqual(["array-shape", "code-range", "ok"]);
  });

  it("no number has less than a bit", () => {
    const ones = new Uint8Array(2 ** 16).fill(255);
    const read = (cells: number): string => refusal(() => new Level(
      { "rice/0": Uint8Array.of(0), core: ones, "basis/0": Uint8Array.of(1) }, [1], [cells], [1]));
    expect(read(2 ** 19)).toBe("ok");
    expect(read(2 ** 19 + 1)).toBe("array-shape level/1/core");
    expect(read(2 ** 19 - 8)).toBe("array-shape level/1/core");
  });

  it("large ones are refused at once", () => {
    const zeros = new Uint8Array(2 ** 26);
    const read = (rows: number): string =>
      refusal(() => new Level({ "rice/0": Uint8Array.of(0), core: zeros, "basis/0": zeros }, [1], [rows], [1]));
    expect(read(2)).toBe("array-shape level/1/core");
    zeros[zeros.length - 1] = 1;
    expect(read(2)).toBe("code-range level/1/core");
  });
});
