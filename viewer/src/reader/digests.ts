/**
 * CRC-32 (that of zlib) and SHA-256.
 *
 * The browser's own SHA-256 is missing on pages that are not loaded securely, and would make the reader asynchronous
 * for a text of some kilobytes.
 */

const WIDTH = 8;
const TABLES = crcTables();

/** Tables for eight bytes at a time: entry [k][b] is byte b followed by k zero bytes. */
function crcTables(): Uint32Array {
  const tables = new Uint32Array(WIDTH * 256);
  for (let byte = 0; byte < 256; byte += 1) {
    let crc = byte;
    for (let bit = 0; bit < 8; bit += 1) {
      crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
    }
    tables[byte] = crc;
  }
  for (let at = 256; at < tables.length; at += 1) {
    const before = tables[at - 256] ?? 0;
    tables[at] = (before >>> 8) ^ (tables[before & 255] ?? 0);
  }
  return tables;
}

/** CRC-32 of some bytes. */
export function crc32(bytes: Uint8Array): number {
  const table = TABLES as ArrayLike<number> as number[]; // indices below are in range by construction
  const data = bytes as ArrayLike<number> as number[];
  const whole = bytes.length - (bytes.length % WIDTH);
  let crc = -1;
  let at = 0;
  for (; at < whole; at += WIDTH) {
    crc ^= data[at]! | (data[at + 1]! << 8) | (data[at + 2]! << 16) | (data[at + 3]! << 24);
    crc = table[1792 + (crc & 255)]! ^ table[1536 + ((crc >>> 8) & 255)]! ^ table[1280 + ((crc >>> 16) & 255)]!
      ^ table[1024 + (crc >>> 24)]! ^ table[768 + data[at + 4]!]! ^ table[512 + data[at + 5]!]!
      ^ table[256 + data[at + 6]!]! ^ table[data[at + 7]!]!;
  }
  for (; at < bytes.length; at += 1) {
    crc = (crc >>> 8) ^ table[(crc ^ data[at]!) & 255]!;
  }
  return (crc ^ -1) >>> 0;
}

/** The first 32 bits of the fractional parts of the `power`-th roots of the first primes. */
function primeRoots(count: number, power: number): Uint32Array {
  const words = new Uint32Array(count);
  for (let number = 2, found = 0; found < count; number += 1) {
    let prime = true;
    for (let factor = 2; factor * factor <= number; factor += 1) {
      prime &&= number % factor !== 0;
    }
    if (prime) {
      words[found] = rootFraction(BigInt(number), power);
      found += 1;
    }
  }
  return words;
}

/** floor(2^32 * frac(number^(1/power))) exactly. */
function rootFraction(number: bigint, power: number): number {
  const scaled = number << BigInt(32 * power);
  let low = 0n;
  let high = 1n << 40n;
  while (high - low > 1n) {
    const middle = (low + high) / 2n;
    [low, high] = middle ** BigInt(power) <= scaled ? [middle, high] : [low, middle];
  }
  return Number(low & 0xffffffffn);
}

const START = primeRoots(8, 2);
const ROUND = primeRoots(64, 3);

function rotate(word: number, by: number): number {
  return (word >>> by) | (word << (32 - by));
}

/** SHA-256 of some bytes, in lower-case hexadecimal digits. */
export function sha256(bytes: Uint8Array): string {
  const padded = new Uint8Array(Math.ceil((bytes.length + 9) / 64) * 64);
  padded.set(bytes);
  padded[bytes.length] = 0x80;
  const view = new DataView(padded.buffer);
  view.setBigUint64(padded.length - 8, BigInt(bytes.length) * 8n);
  const hash = Uint32Array.from(START);
  const words = new Uint32Array(64);
  for (let block = 0; block < padded.length; block += 64) {
    schedule(view, block, words);
    compress(hash, words);
  }
  return Array.from(hash, (word) => word.toString(16).padStart(8, "0")).join("");
}

function schedule(view: DataView, block: number, words: Uint32Array): void {
  for (let i = 0; i < 16; i += 1) {
    words[i] = view.getUint32(block + 4 * i);
  }
  for (let i = 16; i < 64; i += 1) {
    const a = words[i - 15]!;
    const b = words[i - 2]!;
    words[i] = words[i - 16]! + (rotate(a, 7) ^ rotate(a, 18) ^ (a >>> 3)) + words[i - 7]!
      + (rotate(b, 17) ^ rotate(b, 19) ^ (b >>> 10));
  }
}

function compress(hash: Uint32Array, words: Uint32Array): void {
  let [a, b, c, d, e, f, g, h] = hash as unknown as [number, number, number, number, number, number, number, number];
  for (let i = 0; i < 64; i += 1) {
    const first = (h + (rotate(e, 6) ^ rotate(e, 11) ^ rotate(e, 25)) + ((e & f) ^ (~e & g)) + ROUND[i]! + words[i]!) | 0;
    const second = ((rotate(a, 2) ^ rotate(a, 13) ^ rotate(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
    [h, g, f, e, d, c, b, a] = [g, f, e, (d + first) | 0, c, b, a, (first + second) | 0];
  }
  [a, b, c, d, e, f, g, h].forEach((word, i) => {
    hash[i] = hash[i]! + word;
  });
}
