/** A fitted model in memory: flat arrays of each stage of the tree (`docs/format.md`). */

/**
 * The arrays of one stage with S nodes of a tensor with N modes. Lists are indexed by mode; the part of node s in a ragged
 * array X is X[xOffset[s]] to X[xOffset[s + 1] - 1]. Half-precision numbers are kept as their 16-bit patterns, as they go
 * to the GPU.
 *
 * By its C, K and R a node is one of three. All zero: it adds nothing and has no children. A cut, K = R = 0 < C in all
 * modes: it adds nothing, and its rows go to prod C children; not at the last stage. Cells: it adds numbers, and has
 * prod C children or none; a mode with K = 0 is undecomposed in the node: C is 1, R are its rows, and the basis is the
 * identity, of which the node has no entries in `cluster` and `basis`.
 */
export interface PackedLevel {
  nodes: number;
  order: number;
  shape: Uint32Array; // [S, 3, N]: C, K, R of each node
  child: Uint32Array | null; // [S + 1]; null at the last stage
  rowOffset: Uint32Array[]; // [S + 1]
  core: Uint16Array; // per node [PC, R_1, .., R_N]
  coreOffset: Uint32Array;
  coreScale: Float32Array; // per node [PC]
  cellOffset: Uint32Array;
  cluster: Uint16Array[]; // per node [m, K_n]
  clusterOffset: Uint32Array[];
  basis: Uint16Array[]; // per node [m, K_n, PC_-n, R_n]
  basisOffset: Uint32Array[];
  part: (Uint16Array | null)[]; // [rows]; null at the last stage
  local: (Uint32Array | null)[]; // likewise: the position of a row among those of its part
  step: number | null; // D, of which core numbers are multiples; null: float16 numbers, or none
}
