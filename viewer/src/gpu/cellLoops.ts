/**
 * The part of a prelude that adds up the cells of a node for `weighted.wgsl`, for stages whose nodes all have the same
 * ranks: loops with everything in registers, and no branches in a cell. The same text as `hmkcta.render.cell_loops`
 * makes.
 */

import { type Tree, undecomposedIn } from "./tree";

const MOST_CLUSTERS = 32; // of a mode, which are kept in a mask of one word
const MOST_ROWS = 9; // of a mode, which are kept beside each other
const MOST_RANK = 64; // R of a mode that is worth so many registers, and as many lines of text
const UNROLLED = 32; // core numbers that are written out one by one; modes before them are looped over
const MOST_WORDS = 18; // of basis rows of a mode that are written out one by one; longer or more rows are looped over

function product(numbers: number[]): number {
  return numbers.reduce((all, each) => all * each, 1);
}

/** `picked_node(node, depth)`: what a node adds, by registers where its stage allows it, else by `picked_value`. */
export function pickedCells(
  { metadata, uniform }: Tree, room: number[], colour: number | undefined, contracted: number[], tinted: boolean,
): string[] {
  const cases = new Map<string, number[]>();
  const lines: string[] = [];
  for (const stage of uniform) {
    const bounds = metadata.stages[stage]!;
    const { ranks, clusters } = bounds;
    const cells = new Cells(ranks, room, colour, contracted, product(clusters) === 1, tinted);
    if (Math.max(...clusters) > MOST_CLUSTERS || ranks.some((rank, n) => rank > MOST_RANK && !contracted.includes(n)) 
      || Math.max(...room) > MOST_ROWS || undecomposedIn(bounds).some((n) => !contracted.includes(n))) {
      continue;
    }
    if (!cases.has(cells.name)) {
      lines.push(...cells.text());
    }
    cases.set(cells.name, [...(cases.get(cells.name) ?? []), stage]);
  }
  const covered = [...cases.values()].flat().length;
  const rest = covered < metadata.levels.length ? "picked_value(node, depth)" : "Value(0.0)";
  return [
    ...lines, "fn picked_node(node: u32, depth: u32) -> Value {", "  switch depth {",
    ...Array.from(cases, ([name, stages]) => `    case ${stages.map((stage) => `${stage}u`).join(", ")}: { return ${name}(node, depth); }`),
    `    default: { return ${rest}; }`, "  }", "}",
  ];
}

/** Nodes with these ranks; `room` rows of each mode at most; whether there is one cell only, of all rows. */
class Cells {
  private readonly order: number[];
  private readonly kept: number[];

  constructor(
    private readonly ranks: number[], private readonly room: number[], private readonly colour: number | undefined,
    private readonly contracted: number[], private readonly single: boolean, private readonly tinted: boolean,
  ) {
    this.order = ranks.map((_, n) => n);
    this.kept = this.order.filter((n) => !contracted.includes(n));
  }

  get name(): string {
    return `cells_${this.ranks.join("x")}${this.single ? "_single" : ""}`;
  }

  text(): string[] {
    const { order, kept, ranks } = this;
    const last = order.length - 1;
    const head = `fn ${this.name}(node: u32, depth: u32) -> Value {`;
    if (this.single) {
      return [
        head, "  let core = node_core(node);", ...kept.flatMap((n) => this.onlyWeights(n)), ...this.contraction(),
        "  return bitcast<f32>(word(word(node + 2u))) * total;", "}",
      ];
    }
    return [
      head, "  let core_first = node_core(node);", "  let scale_first = word(node + 2u);", "  var sum = Value(0.0);",
      `  let after_${last} = 1u;`,
      ...order.slice(0, -1).reverse().map((n) => `  let after_${n} = after_${n + 1} * node_clusters[${n + 1}];`),
      ...order.flatMap((n) => this.rows(n)), ...order.flatMap((n) => this.loop(n)), `  let cell = flat_${last};`,
      `  let core = core_first + cell * ${product(kept.map((n) => ranks[n]!))}u;`,
      ...kept.flatMap((n) => this.weights(n)), ...this.contraction(),
      "  sum += bitcast<f32>(word(scale_first + cell)) * total;", ...order.map(() => "  }"), "  return sum;", "}",
    ];
  }

  private first(n: number): number {
    return this.room.slice(0, n).reduce((sum, each) => sum + each, 0);
  }

  private stride(n: number): number {
    return product(this.kept.filter((m) => m > n).map((m) => this.ranks[m]!));
  }

  private kind(n: number): string {
    return n === this.colour ? "Value" : "f32";
  }

  /** Whether all rows of a mode are read one beside the other, members of the cell or not. */
  private beside(n: number): boolean {
    return this.room[n]! * Math.ceil(this.ranks[n]! / 2) <= MOST_WORDS;
  }

  /** Halves that addresses of a mode's basis rows count in: words where all rows begin at one. */
  private unit(n: number): 1 | 2 {
    return this.beside(n) && this.ranks[n]! % 2 === 0 ? 2 : 1;
  }

  private weightOf(n: number, i: string): string {
    return n === this.colour ? `row_colour[${i}]` : `row_weight[${this.first(n)}u + ${i}]`;
  }

  /** The weights of a mode in the only cell: the basis rows of all rows inside. */
  private onlyWeights(n: number): string[] {
    const rank = this.ranks[n]!;
    return [
      ...times(rank, (r) => `  var w_${n}_${r} = ${this.kind(n)}(0.0);`),
      `  for (var rows = inside[depth * ORDER + ${n}u]; rows != 0u; rows &= rows - 1u) {`,
      "  let i = firstTrailingBit(rows);", `  let share = ${this.weightOf(n, "i")};`,
      ...numbers(`node_basis[${n}] + row_at[depth * ROWS + ${this.first(n)}u + i] * ${rank}u`, rank),
      ...times(rank, (r) => `  w_${n}_${r} += share * b_${r};`), "  }",
    ];
  }

  /** For each row of a mode inside the node: its clusters as bits, and where its basis rows begin. */
  private rows(n: number): string[] {
    const here = this.kept.includes(n);
    const [size, unit] = [this.room[n]!, this.unit(n)];
    return [
      `  let inside_${n} = inside[depth * ORDER + ${n}u];`, `  var union_${n} = 0u;`,
      ...(here ? [
        `  let basis_${n} = node_basis[${n}]${unit === 2 ? " >> 1u" : ""};`,
        `  let step_${n} = node_others[${n}] * ${this.ranks[n]! / unit}u;`,
        `  var bits_${n}: array<u32, ${size}>;`, `  var base_${n}: array<u32, ${size}>;`,
      ] : []),
      ...(here && !this.beside(n) ? [
        `  var from_${n}: array<u32, ${size}>;`, `  var share_${n}: array<${this.kind(n)}, ${size}>;`,
      ] : []),
      `  for (var rows = inside_${n}; rows != 0u; rows &= rows - 1u) {`, "  let i = firstTrailingBit(rows);",
      `  let row = row_at[depth * ROWS + ${this.first(n)}u + i];`, `  let bits = subset_bits(${n}u, row);`,
      `  union_${n} |= bits;`,
      ...(here ? [
        `  bits_${n}[i] = bits;`, `  base_${n}[i] = basis_${n} + row * node_mixture[${n}] * step_${n};`,
      ] : []),
      "  }",
    ];
  }

  /** The loop over a mode's clusters, and what depends on no other mode: its members' shares and basis rows. */
  private loop(n: number): string[] {
    const before = n === 0 ? "0u" : `flat_${n - 1}`;
    const lines = [
      `  for (var left_${n} = union_${n}; left_${n} != 0u; left_${n} &= left_${n} - 1u) {`,
      `  let c_${n} = firstTrailingBit(left_${n});`, `  let flat_${n} = ${before} * node_clusters[${n}] + c_${n};`,
    ];
    if (!this.kept.includes(n)) {
      return lines;
    }
    lines.push(`  let own_${n} = (${before} * (node_clusters[${n}] - 1u) + c_${n}) * after_${n};`, `  let bit_${n} = 1u << c_${n};`);
    return this.beside(n) ? [...lines, ...times(this.room[n]!, (i) => this.member(n, i)).flat()] : [
      ...lines, `  var members_${n} = 0u;`, `  for (var rows = inside_${n}; rows != 0u; rows &= rows - 1u) {`,
      "  let i = firstTrailingBit(rows);", `  let bits = bits_${n}[i];`, `  if ((bits & bit_${n}) != 0u) {`,
      `  from_${n}[members_${n}] = base_${n}[i] + countOneBits(bits & (bit_${n} - 1u)) * step_${n};`,
      `  share_${n}[members_${n}] = ${this.weightOf(n, "i")};`, `  members_${n} += 1u;`, "  }", "  }",
    ];
  }

  /** Where the basis rows of row i begin, and its share in the cells: 0 where it is no member of the cluster. */
  private member(n: number, i: number): string[] {
    return [
      `  let hit_${n}_${i} = (bits_${n}[${i}] & bit_${n}) != 0u;`,
      `  let share_${n}_${i} = select(${this.kind(n)}(0.0), ${this.weightOf(n, `${i}u`)}, hit_${n}_${i});`,
      `  let from_${n}_${i} = select(basis_${n}, base_${n}[${i}] + countOneBits(bits_${n}[${i}] & (bit_${n} - 1u)) * step_${n}, hit_${n}_${i});`,
    ];
  }

  /** The weights of a mode in the cell: the basis rows of its members, weighted and added up. */
  private weights(n: number): string[] {
    const [rank, room] = [this.ranks[n]!, this.room[n]!];
    const shift = `  let shift_${n} = (cell - own_${n}) * ${rank / this.unit(n)}u;`;
    return this.beside(n) ? [
      shift, ...times(room, (i) => numbers(`from_${n}_${i} + shift_${n}`, rank, `_${n}_${i}`, this.unit(n))).flat(),
      ...times(rank, (r) => `  let w_${n}_${r} = ${times(room, (i) => `share_${n}_${i} * b_${n}_${i}_${r}`).join(" + ")};`),
    ] : [
      shift, ...times(rank, (r) => `  var w_${n}_${r} = ${this.kind(n)}(0.0);`),
      `  for (var i = 0u; i < members_${n}; i++) {`, `  let share = share_${n}[i];`,
      ...numbers(`from_${n}[i] + shift_${n}`, rank), ...times(rank, (r) => `  w_${n}_${r} += share * b_${r};`), "  }",
    ];
  }

  /** `total`: the core times its weights, the mode with the colours outermost. */
  private contraction(): string[] {
    const { ranks, kept } = this;
    const modes = [...kept.filter((n) => n === this.colour), ...kept.filter((n) => n !== this.colour)];
    let inside = modes.length;
    for (let size = 1; inside > 0; inside -= 1) {
      size *= ranks[modes[inside - 1]!]!;
      if (inside < modes.length && (this.single || size > UNROLLED)) {
        break;
      }
    }
    const [outer, inner] = [modes.slice(0, inside), modes.slice(inside)];
    const even = this.contracted.length === 0 && product(ranks) % 2 === 0 && outer.every((n) => this.stride(n) % 2 === 0);
    const at = ["core", ...outer.map((n) => `e_${n} * ${this.stride(n)}u`)].join(" + ");
    const block = [`  let at = ${at};`, ...this.reading(inner, even)];
    const value = this.sum(inner, 0, even);
    if (outer.length === 0) {
      return [...block, `  let total = Value(${value});`];
    }
    return [
      ...outer.map((n) => `  var list_${n} = array<${this.kind(n)}, ${ranks[n]}>(${times(ranks[n]!, (r) => `w_${n}_${r}`).join(", ")});`),
      `  var total = ${this.tinted || outer.some((n) => n === this.colour) ? "Value" : "f32"}(0.0);`,
      ...outer.map((n) => `  for (var e_${n} = 0u; e_${n} < ${ranks[n]}u; e_${n}++) {`), ...block,
      `  total += ${outer.map((n) => `list_${n}[e_${n}]`).join(" * ")} * ${value};`, ...outer.map(() => "  }"),
    ];
  }

  /** Statements that read the core numbers of some modes at `at`; in pairs if that is even. */
  private reading(modes: number[], even: boolean): string[] {
    let offsets = [0];
    for (const n of modes) {
      offsets = offsets.flatMap((offset) => times(this.ranks[n]!, (e) => offset + e * this.stride(n)));
    }
    offsets.sort((a, b) => a - b);
    if (this.contracted.length > 0) {
      return offsets.map((offset) => `  let h_${offset} = core_number(at + ${offset}u);`);
    }
    return even
      ? ["  let pairs = at >> 1u;", ...[...new Set(offsets.map((offset) => offset >> 1))].map((pair) =>
        `  let p_${pair} = unpack2x16float(word(pairs + ${pair}u));`)]
      : offsets.map((offset) => `  let h_${offset} = coefficient(at + ${offset}u);`);
  }

  /** The expression of their sum. */
  private sum([n, ...rest]: number[], offset: number, even: boolean): string {
    if (n === undefined) {
      return even ? `p_${offset >> 1}.${offset % 2 === 0 ? "x" : "y"}` : `h_${offset}`;
    }
    return `(${times(this.ranks[n]!, (e) => `w_${n}_${e} * ${this.sum(rest, offset + e * this.stride(n), even)}`).join(" + ")})`;
  }
}

function times<Result>(count: number, make: (i: number) => Result): Result[] {
  return Array.from({ length: count }, (_, i) => make(i));
}

/** Statements that read `count` neighbouring float16 numbers as `b{name}_0` and so on; `unit` halves an address. */
function numbers(at: string, count: number, name = "", unit: 1 | 2 = 1): string[] {
  if (count === 1) {
    return [`  let b${name}_0 = coefficient(${at});`];
  }
  const words = (count + 1) >> 1;
  const half = (r: number): string => `q${name}_${r >> 1}.${r % 2 === 0 ? "x" : "y"}`;
  const read = [
    `  let a${name} = ${at};`, `  let h${name} = a${name}${unit === 1 ? " >> 1u" : ""};`,
    ...times(words, (k) => `  let q${name}_${k} = unpack2x16float(word(h${name} + ${k}u));`),
  ];
  return count % 2 === 0 // rows of an even length begin at whole words
    ? [...read, ...times(count, (r) => `  let b${name}_${r} = ${half(r)};`)]
    : [...read, `  let odd${name} = (a${name} & 1u) == 1u;`,
      ...times(count, (r) => `  let b${name}_${r} = select(${half(r)}, ${half(r + 1)}, odd${name});`)];
}
