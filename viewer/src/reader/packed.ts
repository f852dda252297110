/** A fitted model as the file stores it: flat arrays a level (`docs/format.md`, section 3). */

/**
 * The arrays of one level with S nodes of a tensor with N modes; null where the format leaves an array out.
 *
 * Lists are indexed by mode. Half-precision numbers are kept as their 16-bit patterns, as they go to the GPU; those that
 * the file has in a byte each, or in codes of few bits, are kept so too (`narrow.ts`, `rice.ts`).
 */
export interface PackedLevel {
  nodes: number;
  order: number;
  shape: Uint32Array; // [S, 3, N]: C, K, R of each node
  child: Uint32Array | null;
  rowOffset: Uint32Array[];
  core: Uint16Array;
  coreOffset: Uint32Array;
  coreScale: Float32Array;
  cellOffset: Uint32Array;
  cluster: (Uint16Array | null)[];
  clusterOffset: (Uint32Array | null)[];
  basis: (Uint16Array | null)[];
  basisOffset: (Uint32Array | null)[];
  part: (Uint16Array | null)[];
  local: (Uint32Array | null)[];
}
