"""The part of a prelude that multiplies the core of a cell with its weights: functions nested as deep as the order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from .tree import Tree, undecomposed_in

#: Of the contracted cores in group 0, behind all pages there can be.
FRAME_BINDING = 8


@dataclass(frozen=True)
class _Nest:
    """Modes in the order of the loops, where their weights begin, and their counts and strides as text.

    The core index of each number of an `indexed` mode is kept beside its weight: the mode may be undecomposed.
    """

    indexed: Sequence[int]
    colour: int | None
    first: Sequence[int]
    modes: Sequence[int]
    counts: Sequence[str]
    strides: Sequence[str]
    name: str
    kind: str  # of core numbers

    def functions(self) -> list[str]:
        """One function a mode, from the outermost; each adds up its mode and multiplies once."""
        lines: list[str] = []
        for place, n in enumerate(self.modes):
            kind = "Value" if n == self.colour else self.kind
            lines += [f"fn {self.name}_{place}(at: u32) -> {kind} {{", *self._body(place, n, kind), "}"]
        if not self.modes:
            lines += [f"fn {self.name}_0(at: u32) -> {self.kind} {{", "  return core_number(at);", "}"]
        return lines

    def _body(self, place: int, n: int, kind: str) -> list[str]:
        first, last = self.first[n], place == len(self.modes) - 1
        weight = "cell_colour[e]" if n == self.colour else f"cell_weight[{first}u + e]"
        index = f"cell_index[{first}u + e]" if n in self.indexed else "e"
        at = f"at + {index} * {self.strides[place]}"
        inner = f"core_number({at})" if last else f"{self.name}_{place + 1}({at})"
        return [f"  var sum = {kind}(0.0);", f"  for (var e = 0u; e < {self.counts[place]}; e++) {{",
                f"    sum += {weight} * {inner};", "  }", "  return sum;"]


def contraction(tree: Tree, taken: Sequence[int], colour: int | None, contracted: Sequence[int],
                tinted: bool = False) -> list[str]:
    """`contract_core(stage)`: the core of the cell at hand times its weights; and `node_core`, where cores begin.

    The mode with the colours comes first, so that all others are done in single numbers. Where it is contracted
    (`tinted`), core numbers are colours themselves.

    Args:
        tree: what is known of the model.
        taken: for each mode the most weights it has in a cell.
        colour: the mode with the colours.
        contracted: modes that are summed into the cores already.
        tinted: whether contracted cores hold colours.
    """
    order, always = tree.order, tree.undecomposed
    rest = [n for n in range(order) if n not in contracted and n != colour]
    modes = rest if colour is None else [colour, *rest]
    first = [sum(taken[:n]) for n in range(order)]
    kind = "Value" if tinted else "f32"
    last = order - 1 if order - 1 not in contracted else max(rest, default=0)
    strides = ["1u" if n == last else f"node_stride[{n}]" for n in modes]
    nests = {"contract": _Nest((*always, *tree.mixed), colour, first, modes, [f"cell_count[{n}]" for n in modes],
                               strides, "contract", kind)}
    cases: dict[str, list[int]] = {}
    for stage in tree.uniform:
        bounds = tree.metadata.stages[stage]
        ranks, own = bounds.ranks, undecomposed_in(bounds)
        name = "contract_" + "x".join(f"{rank}{'w' * (n in own and n not in always)}" for n, rank in enumerate(ranks))
        kept = [n for n in range(order) if n not in contracted]
        fixed = [f"{prod(ranks[m] for m in kept if m > n)}u" for n in modes]
        counts = [f"cell_count[{n}]" if n in own else f"{ranks[n]}u" for n in modes]
        nests[name] = _Nest(own, colour, first, modes, counts, fixed, name, kind)
        cases.setdefault(name, []).append(stage)
    lines = [*_core_numbers(bool(contracted), tinted), *(line for nest in nests.values() for line in nest.functions())]
    choices = [f"    case {', '.join(f'{stage}u' for stage in stages)}: {{ return Value({name}_0(cell_core)); }}"
               for name, stages in cases.items()]
    start = "frame[node / NODE_WORDS] + frame_first" if contracted else "word(node + 1u)"
    return [*lines, "fn contract_core(stage: u32) -> Value {", "  switch stage {", *choices,
            "    default: { return Value(contract_0(cell_core)); }", "  }", "}",
            "fn node_core(node: u32) -> u32 {", f"  return {start};", "}"]


def _core_numbers(framed: bool, tinted: bool) -> list[str]:
    """`core_number(at)`: of the image, or of the contracted cores, of which `frame_first` chooses between sets."""
    chosen = "var<private> frame_first: u32;"
    if not framed:
        return [chosen, "fn core_number(at: u32) -> f32 {", "  return coefficient(at);", "}"]
    numbers = [f"bitcast<f32>(frame[3u * at + {c}u])" for c in range(3)]
    number = f"vec3f({', '.join(numbers)})" if tinted else "bitcast<f32>(frame[at])"
    return [f"@group(0) @binding({FRAME_BINDING}) var<storage, read> frame: array<u32>;", chosen,
            f"fn core_number(at: u32) -> {'vec3f' if tinted else 'f32'} {{", f"  return {number};", "}"]
