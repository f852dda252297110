/** The part of a prelude that multiplies the core of a cell with its weights. Twin of `hmkcta.render.core_sums`. */

import { type Tree, undecomposedIn } from "./tree";

/** Modes in the order of the loops, where their weights begin, and their counts and strides as text. */
interface Nest {
  name: string;
  indexed: number[]; // the core index of each of their numbers is kept beside its weight
  counts: string[];
  strides: string[];
}

interface Shared {
  colour: number | undefined;
  first: number[];
  modes: number[];
  tinted: boolean; // core numbers are colours
}

/** One function a mode, from the outermost; each adds up its mode and multiplies once. */
function functions({ name, indexed, counts, strides }: Nest, shared: Shared): string[] {
  const { colour, first, modes, tinted } = shared;
  const plain = tinted ? "Value" : "f32";
  const lines = modes.flatMap((n, place) => {
    const kind = n === colour ? "Value" : plain;
    const weight = n === colour ? "cell_colour[e]" : `cell_weight[${first[n]}u + e]`;
    const index = indexed.includes(n) ? `cell_index[${first[n]}u + e]` : "e";
    const at = `at + ${index} * ${strides[place]}`;
    const inner = place === modes.length - 1 ? `core_number(${at})` : `${name}_${place + 1}(${at})`;
    return [
      `fn ${name}_${place}(at: u32) -> ${kind} {`, `  var sum = ${kind}(0.0);`,
      `  for (var e = 0u; e < ${counts[place]}; e++) {`, `    sum += ${weight} * ${inner};`, "  }", "  return sum;", "}",
    ];
  });
  return modes.length > 0 ? lines : [`fn ${name}_0(at: u32) -> ${plain} {`, "  return core_number(at);", "}"];
}

/**
 * `contract_core(stage)`: the core of the cell at hand times its weights; and `node_core`, where cores begin. The mode
 * with the colours comes first, so that all others are done in single numbers. `taken` says for each mode how many
 * weights it has at most; `tinted` whether contracted cores hold colours.
 */
export function contraction(
  tree: Tree, taken: number[], colour: number | undefined, contracted: number[], tinted: boolean,
): string[] {
  const { metadata, undecomposed } = tree;
  const order = metadata.modeSizes.length;
  const all = Array.from({ length: order }, (_, n) => n);
  const kept = all.filter((n) => !contracted.includes(n));
  const rest = kept.filter((n) => n !== colour);
  const modes = colour === undefined ? rest : [colour, ...rest];
  const first = all.map((n) => taken.slice(0, n).reduce((sum, each) => sum + each, 0));
  const folded = contracted.length > 0;
  const shared = { colour, first, modes, tinted };
  const last = contracted.includes(order - 1) ? Math.max(0, ...rest) : order - 1;
  const nests = new Map<string, Nest>([["contract", {
    name: "contract", indexed: [...undecomposed, ...tree.mixed], counts: modes.map((n) => `cell_count[${n}]`),
    strides: modes.map((n) => (n === last ? "1u" : `node_stride[${n}]`)),
  }]]);
  const cases = new Map<string, number[]>();
  for (const stage of tree.uniform) {
    const bounds = metadata.stages[stage]!;
    const [{ ranks }, own] = [bounds, undecomposedIn(bounds)];
    const name = `contract_${ranks.map((rank, n) => `${rank}${own.includes(n) && !undecomposed.includes(n) ? "w" : ""}`).join("x")}`;
    const stride = (n: number): number => kept.reduce((product, m) => (m > n ? product * ranks[m]! : product), 1);
    nests.set(name, {
      name, indexed: own, strides: modes.map((n) => `${stride(n)}u`),
      counts: modes.map((n) => (own.includes(n) ? `cell_count[${n}]` : `${ranks[n]}u`)),
    });
    cases.set(name, [...(cases.get(name) ?? []), stage]);
  }
  return [
    ...coreNumbers(folded, tinted),
    ...[...nests.values()].flatMap((nest) => functions(nest, shared)),
    "fn contract_core(stage: u32) -> Value {", "  switch stage {",
    ...Array.from(cases, ([name, stages]) =>
      `    case ${stages.map((stage) => `${stage}u`).join(", ")}: { return Value(${name}_0(cell_core)); }`),
    "    default: { return Value(contract_0(cell_core)); }", "  }", "}",
    "fn node_core(node: u32) -> u32 {", `  return ${folded ? "frame[node / NODE_WORDS] + frame_first" : "word(node + 1u)"};`, "}",
  ];
}

/** `core_number(at)`: of the image, or of the contracted cores, of which `frame_first` chooses between sets. */
function coreNumbers(folded: boolean, tinted: boolean): string[] {
  const chosen = "var<private> frame_first: u32;";
  if (!folded) {
    return [chosen, "fn core_number(at: u32) -> f32 {", "  return coefficient(at);", "}"];
  }
  const numbers = [0, 1, 2].map((c) => `bitcast<f32>(frame[3u * at + ${c}u])`);
  return [
    "@group(0) @binding(8) var<storage, read> frame: array<u32>;", chosen,
    `fn core_number(at: u32) -> ${tinted ? "vec3f" : "f32"} {`,
    `  return ${tinted ? `vec3f(${numbers.join(", ")})` : "bitcast<f32>(frame[at])"};`, "}",
  ];
}
