/** Numbers of fewer than eight bits one after the other, without gaps (`docs/format.md`, section 3, packed bases). */

/** Most bits of a number of a packed basis. */
export const MOST_BITS = 8;

/** How the numbers of a mode's bases follow one another: node by node, and in a node column by column. */
export interface Columns {
  width: Uint8Array; // by node [R_n]: bits of a number of each column
  ranks: Uint32Array; // [S]
  offsets: Uint32Array; // [S + 1], of numbers
}

/** Write what the numbers of a packed basis stand for; `numbers` has that of each byte, by its bits. */
export function fromStream(stream: Uint8Array, columns: Columns, numbers: Uint16Array, into: Uint16Array): void {
  const { width, ranks, offsets } = columns;
  let next = 0; // byte of the stream
  let held = 0; // bits of those before it that belong to later numbers, and how many
  let left = 0;
  let first = 0; // column of the node among those of all
  for (let s = 0; s < ranks.length; s += 1) {
    const end = first + ranks[s]!;
    for (let at = offsets[s]!, column = first; at < offsets[s + 1]!; at += 1) {
      const bits = width[column]!;
      if (left < bits) {
        held |= stream[next]! << left;
        next += 1;
        left += 8;
      }
      into[at] = numbers[(held << (8 - bits)) & 255]!;
      held >>= bits;
      left -= bits;
      column = column + 1 === end ? first : column + 1;
    }
    first = end;
  }
}
