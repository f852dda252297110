/** Where the models of each context of a run's codes lie. */

import { ESCAPE, LABEL, UNARY, WHOLE } from "./coder";

/** Kinds of nodes, as contexts count them. */
export const [EMPTY, CELLS, CUT] = [0, 1, 2];
/** Classes of what the neighbours of a number let expect, by their sum; whatever is larger is of the last one. */
export const NEIGHBOURS = Uint8Array.of(0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 5, 6);
export const NEIGHBOUR_CLASSES = 7;
export const BASIS_CLASSES = 80;
export const CORE_CLASSES = 96;
export const SIGN_CLASSES = 16;
/** Ranks by their digits. */
export const RANK_CLASSES = 13;
/** Places among a row's clusters. */
export const MEMBER_CLASSES = 8;

export class Contexts {
  /** Models of all. */
  size = 0;
  readonly kind = this.take(3 * 2);
  readonly parted = this.take(2);
  readonly firstColumn = this.take(WHOLE);
  readonly basis = this.take(BASIS_CLASSES * NEIGHBOUR_CLASSES * UNARY);
  readonly basisEscape = this.take(ESCAPE);
  readonly basisSign = this.take(9 * SIGN_CLASSES);
  readonly core = this.take(CORE_CLASSES * NEIGHBOUR_CLASSES * UNARY);
  readonly coreEscape = this.take(ESCAPE);
  readonly coreSign = this.take(9);
  /** By mode. */
  readonly modes: ModeContexts[];

  constructor(order: number) {
    this.modes = Array.from({ length: order }, () => ({
      undecomposed: this.take(2), clusters: this.take(WHOLE), mixture: this.take(WHOLE), rank: this.take(RANK_CLASSES * WHOLE),
      column: this.take(2 * WHOLE), rule: this.take(1), grid: this.take(WHOLE),
      same: this.take(2), member: this.take(MEMBER_CLASSES * LABEL), sameCut: this.take(2), cutLabel: this.take(LABEL),
      slots: this.take(1), slot: this.take(LABEL), samePart: this.take(2), partLabel: this.take(LABEL),
    }));
  }

  private take(models: number): number {
    this.size += models;
    return this.size - models;
  }
}

export interface ModeContexts {
  undecomposed: number; // 2
  clusters: number;
  mixture: number;
  rank: number; // by the digits of the last one
  column: number; // the first one of a mode, and others
  rule: number;
  grid: number;
  same: number; // 2, as of the cut and parts
  member: number; // by the place among a row's clusters
  sameCut: number;
  cutLabel: number;
  slots: number;
  slot: number;
  samePart: number;
  partLabel: number;
}
