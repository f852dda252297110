/** CRC-32, that of zlib. */

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
