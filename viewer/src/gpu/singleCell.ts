/**
 * The part of a prelude that decodes a model of one cell, as PCA and HOSVD make them. The same text as
 * `hmkcta.render.single_cell` makes.
 */

import type { Tree } from "./tree";

const UNROLLED = 8; // numbers of a core's last mode that are written out one by one; more are looped over

/** Whether the model is one cell. */
export function isSingle({ metadata: { stages }, uniform }: Tree): boolean {
  return stages.length === 1 && uniform.join() === "0" && stages[0]!.clusters.every((count) => count === 1);
}

/** `decode_picked(stages)`, where `isSingle`; `places` has for each axis its mode and stride. */
export function singleCell(
  tree: Tree, places: { mode: number; stride: number }[], colour: number | undefined, contracted: number[], tinted: boolean,
): string[] {
  const modes = tree.metadata.modeSizes.flatMap((_, n) => (contracted.includes(n) ? [] : [n]));
  const nested = [...modes.filter((n) => n === colour), ...modes.filter((n) => n !== colour)];
  const cell = new Cell(tree, places, colour, nested, contracted.length > 0, tinted);
  return [
    "fn decode_picked(stages: u32) -> Value {", ...modes.flatMap((n) => cell.weights(n)), ...cell.core(),
    "  return bitcast<f32>(word(word(2u))) * total;", "}",
  ];
}

/** The cell; `modes` in the order of the loops over the core. */
class Cell {
  private readonly ranks: number[];

  constructor(
    private readonly tree: Tree, private readonly places: { mode: number; stride: number }[],
    private readonly colour: number | undefined, private readonly modes: number[], private readonly framed: boolean,
    private readonly tinted: boolean,
  ) {
    this.ranks = tree.metadata.stages[0]!.ranks;
  }

  /** `w_n`: the basis rows of mode n, weighted and added up; those of a colour count in its channel only. */
  weights(n: number): string[] {
    if (this.tree.undecomposed.includes(n)) {
      return [];
    }
    const [rank, tint] = [this.ranks[n]!, this.tint(n)];
    const channels = [0, 1, 2];
    return [
      `  let basis_${n} = word(${3 + 5 * n + 4}u);`, `  var w_${n}: array<${tint === undefined ? "f32" : "Value"}, ${rank}>;`,
      "  {", ...this.rows(n),
      ...(tint === undefined ? [`  let at = basis_${n} + row * ${rank}u;`, ...added(n, rank)] : [
        ...channels.map((c) => `  let at_${c} = basis_${n} + (row + ${this.index(tint, `${c}u`)}) * ${rank}u;`),
        `  for (var e = 0u; e < ${rank}u; e++) {`,
        `  w_${n}[e] += share * vec3f(${channels.map((c) => `coefficient(at_${c} + e)`).join(", ")});`, "  }",
      ]), ...this.axes(n).map(() => "  }"), "  }",
    ];
  }

  /** `total`: the core times its weights, each mode added up before it is multiplied. */
  core(): string[] {
    return this.modes.length === 0 ? ["  let total = core_number(node_core(0u));"]
      : ["  let at_0 = node_core(0u);", ...this.nest(0), "  let total = Value(sum_0);"];
  }

  /** The axis of the colours, if it is in mode n and weights are colours. */
  private tint(n: number): number | undefined {
    const axis = this.places.findIndex(({ mode }, a) => mode === n && this.tree.metadata.axes[a]!.role === "channel");
    return n === this.colour && axis >= 0 ? axis : undefined;
  }

  /** The axes of mode n, but for that of the colours. */
  private axes(n: number): number[] {
    return this.places.flatMap(({ mode }, axis) => (mode === n && axis !== this.tint(n) ? [axis] : []));
  }

  /** By how many rows pick k of an axis counts. */
  private index(axis: number, k: string): string {
    return `pick_index[${axis}u * PICKS + ${k}] * ${this.places[axis]!.stride}u`;
  }

  /** Loops over the picks of a mode's axes, with `row` and `share`. */
  private rows(n: number): string[] {
    const axes = this.axes(n);
    const row = axes.map((axis) => this.index(axis, `i_${axis}`)).join(" + ") || "0u";
    const share = axes.map((axis) => `pick_weight[${axis}u * PICKS + i_${axis}]`).join(" * ") || "1.0";
    return [
      ...axes.map((axis) => `  for (var i_${axis} = 0u; i_${axis} < pick_count[${axis}]; i_${axis}++) {`),
      `  let row = ${row};`, `  let share = ${share};`,
    ];
  }

  /** `sum_k` over the k-th mode and all behind it, of the numbers from `at_k` on. */
  private nest(k: number): string[] {
    const n = this.modes[k]!;
    const kind = this.tinted || (k === 0 && n === this.colour) ? "Value" : "f32";
    const [rank, stride] = [this.ranks[n]!, this.modes.reduce((product, m) => (m > n ? product * this.ranks[m]! : product), 1)];
    const inner = k + 1 < this.modes.length ? this.nest(k + 1) : [`  let sum_${k + 1} = core_number(at_${k + 1});`];
    const head = `  var sum_${k} = ${kind}(0.0);`;
    if (this.tree.undecomposed.includes(n)) {
      const tint = this.tint(n);
      const close = this.axes(n).map(() => "  }");
      return tint === undefined ? [
        head, ...this.rows(n), `  let at_${k + 1} = at_${k} + row * ${stride}u;`, ...inner, `  sum_${k} += share * sum_${k + 1};`, ...close,
      ] : [
        head, ...this.rows(n), "  for (var c = 0u; c < 3u; c++) {",
        `  let at_${k + 1} = at_${k} + (row + ${this.index(tint, "c")}) * ${stride}u;`, ...inner,
        `  sum_${k} += share * sum_${k + 1} * channel(c);`, "  }", ...close,
      ];
    }
    if (k + 1 < this.modes.length) {
      return [
        head, `  for (var e_${k} = 0u; e_${k} < ${rank}u; e_${k}++) {`, `  let at_${k + 1} = at_${k} + e_${k} * ${stride}u;`, ...inner,
        `  sum_${k} += w_${n}[e_${k}] * sum_${k + 1};`, "  }",
      ];
    }
    const step = stride === 1 && rank % 2 === 0 && !this.framed ? 2 : 1;
    if (rank <= UNROLLED) {
      return [head, ...Array.from({ length: rank / step }, (_, e) => this.term(k, `${step * e}u`, step, stride))];
    }
    return [head, `  for (var e = 0u; e < ${rank}u; e += ${step}u) {`, this.term(k, "e", step, stride), "  }"];
  }

  /** The statement that adds one or two neighbouring numbers of the last mode. */
  private term(k: number, e: string, step: number, stride: number): string {
    const n = this.modes[k]!;
    return step === 1 ? `  sum_${k} += w_${n}[${e}] * core_number(at_${k} + ${e} * ${stride}u);`
      : `  sum_${k} += dot(vec2f(w_${n}[${e}], w_${n}[${e} + 1u]), unpack2x16float(word((at_${k} + ${e}) >> 1u)));`;
  }
}

/** Statements that add the row at `at` times `share` to `w_n`: two numbers a word where rows begin at whole words. */
function added(n: number, rank: number): string[] {
  return rank % 2 === 1
    ? [`  for (var e = 0u; e < ${rank}u; e++) {`, `  w_${n}[e] += share * coefficient(at + e);`, "  }"]
    : [`  for (var e = 0u; e < ${rank}u; e += 2u) {`, "  let pair = share * unpack2x16float(word((at + e) >> 1u));",
      `  w_${n}[e] += pair.x;`, `  w_${n}[e + 1u] += pair.y;`, "  }"];
}
