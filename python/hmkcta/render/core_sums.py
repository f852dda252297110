"""The part of a prelude that multiplies the core of a cell with its weights: functions nested as deep as the order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from ..packed import Metadata, PackedLevel

#: Of the contracted cores in group 0, behind all pages there can be.
FRAME_BINDING = 8


@dataclass(frozen=True)
class _Nest:
    """Modes in the order of the loops, where their weights begin, and their counts and strides as text."""

    metadata: Metadata
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
        index = f"cell_index[{first}u + e]" if n in self.metadata.undecomposed else "e"
        at = f"at + {index} * {self.strides[place]}"
        inner = f"core_number({at})" if last else f"{self.name}_{place + 1}({at})"
        return [f"  var sum = {kind}(0.0);", f"  for (var e = 0u; e < {self.counts[place]}; e++) {{",
                f"    sum += {weight} * {inner};", "  }", "  return sum;"]


def contraction(metadata: Metadata, taken: Sequence[int], colour: int | None, contracted: Sequence[int],
                uniform: Sequence[int], tinted: bool = False) -> list[str]:
    """`contract_core(level)`: the core of the cell at hand times its weights; and `node_core`, where cores begin.

    The mode with the colours comes first, so that all others are done in single numbers. Where it is contracted
    (`tinted`), core numbers are colours themselves.

    Args:
        metadata: the model's.
        taken: for each mode the most weights it has in a cell.
        colour: the mode with the colours.
        contracted: modes that are summed into the cores already.
        uniform: levels, from 0, whose loops get constant bounds.
        tinted: whether contracted cores hold colours.
    """
    order = len(metadata.organisation)
    rest = [n for n in range(order) if n not in contracted and n != colour]
    modes = rest if colour is None else [colour, *rest]
    first = [sum(taken[:n]) for n in range(order)]
    kind = "Value" if tinted else "f32"
    last = order - 1 if order - 1 not in contracted else max(rest, default=0)
    strides = ["1u" if n == last else f"node_stride[{n}]" for n in modes]
    nests = {"contract": _Nest(metadata, colour, first, modes, [f"cell_count[{n}]" for n in modes], strides, "contract",
                               kind)}
    cases: dict[str, list[int]] = {}
    for level in uniform:
        ranks = metadata.levels[level].ranks
        name = "contract_" + "x".join(str(rank) for rank in ranks)
        kept = [n for n in range(order) if n not in contracted]
        fixed = [f"{prod(ranks[m] for m in kept if m > n)}u" for n in modes]
        counts = [f"cell_count[{n}]" if n in metadata.undecomposed else f"{ranks[n]}u" for n in modes]
        nests[name] = _Nest(metadata, colour, first, modes, counts, fixed, name, kind)
        cases.setdefault(name, []).append(level)
    lines = [*_core_numbers(bool(contracted), tinted), *(line for nest in nests.values() for line in nest.functions())]
    choices = [f"    case {', '.join(f'{level}u' for level in levels)}: {{ return Value({name}_0(cell_core)); }}"
               for name, levels in cases.items()]
    start = "frame[node / NODE_WORDS] + frame_first" if contracted else "word(node + 1u)"
    return [*lines, "fn contract_core(level: u32) -> Value {", "  switch level {", *choices,
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


def uniform_levels(metadata: Metadata, levels: Sequence[PackedLevel]) -> tuple[int, ...]:
    """Levels, from 0, whose nodes that are not empty all have the ranks that the metadata give.

    >>> from hmkcta._example import example_level, example_metadata
    >>> uniform_levels(example_metadata(), [example_level()])
    (0,)
    """
    return tuple(
        number for number, (bounds, level) in enumerate(zip(metadata.levels, levels, strict=True))
        if level.nodes and (level.shape[:, 2] == bounds.ranks)[level.shape[:, 0, 0] > 0].all())
