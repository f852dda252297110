/** The arrays of a stage, made as large as the header says, and filled run by run. */

import type { PackedLevel } from "./packed";
import { fault } from "./reasons";
import { type Run, type Stage, total } from "./stages";
import { Children, type Nodes } from "./tree";

/** What a run may fill: where its share of the arrays ends. */
export interface Share {
  nodes: number;
  cells: number;
  core: number;
  basis: number[];
}

/** A stage that is being read; node by node, numbers are appended to its arrays. */
export class Arrays {
  readonly level: PackedLevel;
  readonly children: Children | null;
  readonly order: number;
  /** Nodes that are done, and what the runs up to the one at hand may fill. */
  done = 0;
  share: Share;
  private run = "";

  /** `below`: the next stage, if there is one. */
  constructor(readonly stage: Stage, readonly nodes: Nodes, private readonly below: Stage | null, readonly where: string) {
    const order = nodes.rows.length;
    const sum = (count: (run: Run) => number): number => total(stage, count);
    const offsets = (): Uint32Array => new Uint32Array(stage.nodes + 1);
    const byMode = <T>(make: (n: number) => T): T[] => Array.from({ length: order }, (_, n) => make(n));
    // A row's cluster has a basis number at the least.
    const entries = (n: number): number => Math.min(stage.rows[n]! * stage.mixture[n]!, sum((run) => run.basis[n]!));
    this.order = order;
    this.level = {
      order, nodes: stage.nodes, step: stage.step, shape: new Uint32Array(3 * order * stage.nodes), child: null,
      rowOffset: byMode((n) => offsetsOf(nodes.rows[n]!)),
      core: new Uint16Array(sum((run) => run.core)), coreOffset: offsets(),
      coreScale: new Float32Array(sum((run) => run.cells)), cellOffset: offsets(),
      cluster: byMode((n) => new Uint16Array(entries(n))), clusterOffset: byMode(offsets),
      basis: byMode((n) => new Uint16Array(sum((run) => run.basis[n]!))), basisOffset: byMode(offsets),
      part: byMode((n) => (below === null ? null : new Uint16Array(stage.rows[n]!))),
      local: byMode((n) => (below === null ? null : new Uint32Array(stage.rows[n]!))),
    };
    this.children = below === null ? null : new Children(stage.nodes, below.nodes, order, this.where);
    this.share = { nodes: 0, cells: 0, core: 0, basis: byMode(() => 0) };
  }

  /** Let the next run fill its share. */
  begin(run: Run, where: string): void {
    this.run = where;
    const { nodes, cells, core, basis } = this.share;
    this.share = {
      nodes: nodes + run.nodes, cells: cells + run.cells, core: core + run.core,
      basis: basis.map((count, n) => count + run.basis[n]!),
    };
  }

  /** The node at hand takes so many cells and numbers; the offsets behind it. */
  take(cells: number, core: number, clusters: number[], basis: number[]): void {
    const { level, share, done } = this;
    const least = level.cellOffset[done]! + cells > share.cells || level.coreOffset[done]! + core > share.core
      || basis.some((count, n) => level.basisOffset[n]![done]! + count > share.basis[n]!);
    if (least) {
      throw this.miscounted("more cells or numbers");
    }
    level.cellOffset[done + 1] = level.cellOffset[done]! + cells;
    level.coreOffset[done + 1] = level.coreOffset[done]! + core;
    for (let n = 0; n < this.order; n += 1) {
      level.clusterOffset[n]![done + 1] = level.clusterOffset[n]![done]! + clusters[n]!;
      level.basisOffset[n]![done + 1] = level.basisOffset[n]![done]! + basis[n]!;
    }
  }

  /** The run at hand is over: it must have filled its share. */
  end(): void {
    const { level, share, done } = this;
    if (level.cellOffset[done] !== share.cells || level.coreOffset[done] !== share.core
      || share.basis.some((count, n) => level.basisOffset[n]![done] !== count)) {
      throw this.miscounted("fewer cells or numbers");
    }
  }

  /** Numbers of the run that is over, which are stored as they are: core, bases, scales. */
  fill(bytes: Uint8Array, run: Run): void {
    const { level, share } = this;
    let at = 0;
    const next = (length: number): ArrayBuffer => {
      at += length;
      return bytes.slice(at - length, at).buffer as ArrayBuffer; // at a place where numbers may begin
    };
    level.core.set(new Uint16Array(next(2 * run.core)), share.core - run.core);
    run.basis.forEach((count, n) => level.basis[n]!.set(new Uint16Array(next(2 * count)), share.basis[n]! - count));
    level.coreScale.set(new Float32Array(next(4 * run.cells)), share.cells - run.cells);
  }

  private miscounted(found: string): Error {
    return fault("run-count", this.run, `${found} than the header says of a run`, "as many");
  }

  /** All runs are read: what the nodes of the next stage are. */
  finish(): Nodes | null {
    const { below, level, children } = this;
    level.cluster = level.cluster.map((entries, n) => entries.subarray(0, level.clusterOffset[n]![level.nodes]));
    level.child = children?.child ?? null;
    return below === null ? null : children!.finish(below.rows);
  }
}

function offsetsOf(rows: Uint32Array): Uint32Array {
  const offsets = new Uint32Array(rows.length + 1);
  rows.forEach((count, s) => {
    offsets[s + 1] = offsets[s]! + count;
  });
  return offsets;
}
