"""The part of a prelude that adds up the cells of a node for `weighted.wgsl`: loops with everything in registers.

For stages whose nodes all have the same ranks. One loop a mode goes over the clusters that any row inside the node is a
member of. What depends on one mode alone (is the row a member, where do its basis rows of this cluster begin) is found
in the loop of that mode, so that the innermost one has nothing left but to read and to multiply.

It does so without a branch where the rows of a mode are few: a row that is no member of the cell counts with weight 0.
Neighbouring pixels differ in their members, so that a branch would be taken for most rows anyway, and reads that do not
wait for each other can be under way together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from .tree import Tree, undecomposed_in

#: Clusters of a mode are kept in a mask of one word.
_MOST_CLUSTERS = 32
#: Rows of a mode that are kept beside each other.
_MOST_ROWS = 9
#: R of a mode that is worth so many registers, and as many lines of text.
_MOST_RANK = 64
#: Core numbers that are written out one by one; modes before them are looped over.
_UNROLLED = 32
#: Words of basis rows of a mode that are written out one by one; longer or more rows are looped over.
_MOST_WORDS = 18


def picked_cells(tree: Tree, room: Sequence[int], colour: int | None, contracted: Sequence[int],
                 tinted: bool = False) -> list[str]:
    """`picked_node(node, depth)`: what a node adds, by registers where its stage allows it, else by `picked_value`.

    Args:
        tree: what is known of the model.
        room: for each mode the most rows that it has at once.
        colour: the mode with the colours.
        contracted: modes that are summed into the cores already.
        tinted: whether contracted cores hold colours.
    """
    chosen = registered_stages(tree, room, colour, contracted, tinted)
    cases: dict[str, list[int]] = {}
    lines: list[str] = []
    for stage, cells in chosen.items():
        if cells.name not in cases:
            lines += cells.function()
        cases.setdefault(cells.name, []).append(stage)
    choices = [f"    case {', '.join(f'{stage}u' for stage in stages)}: {{ return {name}(node, depth); }}"
               for name, stages in cases.items()]
    rest = "picked_value(node, depth)" if len(chosen) < len(tree.metadata.levels) else "Value(0.0)"
    return [*lines, "fn picked_node(node: u32, depth: u32) -> Value {", "  switch depth {", *choices,
            f"    default: {{ return {rest}; }}", "  }", "}"]


def registered_stages(tree: Tree, room: Sequence[int], colour: int | None, contracted: Sequence[int],
                      tinted: bool = False) -> dict[int, Cells]:
    """The stages, from 0, whose cells are added up by registers, with the arguments of `picked_cells`."""
    if max(room) > _MOST_ROWS:
        return {}
    return {stage: Cells(bounds.ranks, tuple(room), colour, tuple(contracted), prod(bounds.clusters) == 1, tinted)
            for stage in tree.uniform for bounds in [tree.metadata.stages[stage]]
            if max(bounds.clusters) <= _MOST_CLUSTERS and set(undecomposed_in(bounds)) <= set(contracted)
            and all(rank <= _MOST_RANK for n, rank in enumerate(bounds.ranks) if n not in contracted)}


@dataclass(frozen=True)
class Cells:
    """Nodes with these ranks; `room` rows of each mode at most; whether there is one cell only, of all rows."""

    ranks: Sequence[int]
    room: Sequence[int]
    colour: int | None
    contracted: Sequence[int]
    single: bool
    tinted: bool = False

    @property
    def name(self) -> str:
        return "cells_" + "x".join(str(rank) for rank in self.ranks) + ("_single" if self.single else "")

    @property
    def kept(self) -> list[int]:
        """Modes that are not contracted."""
        return [n for n in range(len(self.ranks)) if n not in self.contracted]

    @property
    def turns(self) -> int:
        """Of the loops over a cell's core."""
        outer, _ = self._split()
        return sum(prod(self.ranks[n] for n in outer[: k + 1]) for k in range(len(outer)))

    def stride(self, n: int) -> int:
        """Of a mode in the core."""
        return prod(self.ranks[m] for m in self.kept if m > n)

    def function(self) -> list[str]:
        """The function: a loop a mode, and in the innermost one the cell; no such loops where there is one cell."""
        order = range(len(self.ranks))
        lines = [f"fn {self.name}(node: u32, depth: u32) -> Value {{"]
        if self.single:
            lines += ["  let core = node_core(node);"]
            lines += [line for n in self.kept for line in self._only_weights(n)]
            return [*lines, *self._contraction(), "  return bitcast<f32>(word(word(node + 2u))) * total;", "}"]
        lines += ["  let core_first = node_core(node);", "  let scale_first = word(node + 2u);",
                  "  var sum = Value(0.0);", f"  let after_{order[-1]} = 1u;",
                  *(f"  let after_{n} = after_{n + 1} * node_clusters[{n + 1}];" for n in reversed(order[:-1]))]
        for n in order:
            lines += self._rows(n)
        for n in order:
            lines += self._loop(n)
        lines += [f"  let cell = flat_{order[-1]};",
                  f"  let core = core_first + cell * {prod(self.ranks[n] for n in self.kept)}u;"]
        for n in self.kept:
            lines += self._weights(n)
        lines += [*self._contraction(), "  sum += bitcast<f32>(word(scale_first + cell)) * total;"]
        return [*lines, *("  }" for _ in order), "  return sum;", "}"]

    def _only_weights(self, n: int) -> list[str]:
        """The weights of a mode in the only cell: the basis rows of all rows inside."""
        first, rank = sum(self.room[:n]), self.ranks[n]
        return [*(f"  var w_{n}_{r} = {self.kind(n)}(0.0);" for r in range(rank)),
                f"  for (var rows = inside[depth * ORDER + {n}u]; rows != 0u; rows &= rows - 1u) {{",
                "  let i = firstTrailingBit(rows);", f"  let share = {self._weight(n, 'i')};",
                *_numbers(f"node_basis[{n}] + row_at[depth * ROWS + {first}u + i] * {rank}u", rank),
                *(f"  w_{n}_{r} += share * b_{r};" for r in range(rank)), "  }"]

    def beside(self, n: int) -> bool:
        """Whether all rows of a mode are read one beside the other, members of the cell or not."""
        return self.room[n] * -(-self.ranks[n] // 2) <= _MOST_WORDS

    def _unit(self, n: int) -> int:
        """Halves that addresses of a mode's basis rows count in: words where all rows begin at one."""
        return 2 if self.beside(n) and self.ranks[n] % 2 == 0 else 1

    def _weight(self, n: int, i: str) -> str:
        """The weight of row i of a mode."""
        first = sum(self.room[:n])
        return f"row_colour[{i}]" if n == self.colour else f"row_weight[{first}u + {i}]"

    def _rows(self, n: int) -> list[str]:
        """For each row of a mode inside the node: its clusters as bits, and where its basis rows begin."""
        first, room = sum(self.room[:n]), self.room[n]
        lines = [f"  let inside_{n} = inside[depth * ORDER + {n}u];", f"  var union_{n} = 0u;"]
        if n in self.kept:
            unit = self._unit(n)
            lines += [f"  let basis_{n} = node_basis[{n}]{' >> 1u' if unit == 2 else ''};",
                      f"  let step_{n} = node_others[{n}] * {self.ranks[n] // unit}u;",
                      f"  var bits_{n}: array<u32, {room}>;", f"  var base_{n}: array<u32, {room}>;"]
            if not self.beside(n):
                lines += [f"  var from_{n}: array<u32, {room}>;", f"  var share_{n}: array<{self.kind(n)}, {room}>;"]
        lines += [f"  for (var rows = inside_{n}; rows != 0u; rows &= rows - 1u) {{",
                  "  let i = firstTrailingBit(rows);", f"  let row = row_at[depth * ROWS + {first}u + i];",
                  f"  let bits = subset_bits({n}u, row);", f"  union_{n} |= bits;"]
        if n in self.kept:
            lines += [f"  bits_{n}[i] = bits;", f"  base_{n}[i] = basis_{n} + row * node_mixture[{n}] * step_{n};"]
        return [*lines, "  }"]

    def _loop(self, n: int) -> list[str]:
        """The loop over a mode's clusters, and what depends on no other mode: its members' shares and basis rows."""
        before = "0u" if n == 0 else f"flat_{n - 1}"
        lines = [f"  for (var left_{n} = union_{n}; left_{n} != 0u; left_{n} &= left_{n} - 1u) {{",
                 f"  let c_{n} = firstTrailingBit(left_{n});",
                 f"  let flat_{n} = {before} * node_clusters[{n}] + c_{n};"]
        if n in self.contracted:
            return lines
        lines += [f"  let own_{n} = ({before} * (node_clusters[{n}] - 1u) + c_{n}) * after_{n};",
                  f"  let bit_{n} = 1u << c_{n};"]
        if self.beside(n):
            return [*lines, *(line for i in range(self.room[n]) for line in self._member(n, i))]
        return [*lines, f"  var members_{n} = 0u;", f"  for (var rows = inside_{n}; rows != 0u; rows &= rows - 1u) {{",
                "  let i = firstTrailingBit(rows);", f"  let bits = bits_{n}[i];", f"  if ((bits & bit_{n}) != 0u) {{",
                f"  from_{n}[members_{n}] = base_{n}[i] + countOneBits(bits & (bit_{n} - 1u)) * step_{n};",
                f"  share_{n}[members_{n}] = {self._weight(n, 'i')};", f"  members_{n} += 1u;", "  }", "  }"]

    def _member(self, n: int, i: int) -> list[str]:
        """Where the basis rows of row i begin, and its share in the cells: 0 where it is no member of the cluster."""
        return [f"  let hit_{n}_{i} = (bits_{n}[{i}] & bit_{n}) != 0u;",
                f"  let share_{n}_{i} = select({self.kind(n)}(0.0), {self._weight(n, f'{i}u')}, hit_{n}_{i});",
                f"  let from_{n}_{i} = select(basis_{n}, base_{n}[{i}] + countOneBits(bits_{n}[{i}] & (bit_{n} - 1u))"
                f" * step_{n}, hit_{n}_{i});"]

    def _weights(self, n: int) -> list[str]:
        """The weights of a mode in the cell: the basis rows of its members, weighted and added up."""
        rank = self.ranks[n]
        shift = f"  let shift_{n} = (cell - own_{n}) * {rank // self._unit(n)}u;"
        if self.beside(n):
            rows = range(self.room[n])
            return [shift, *(line for i in rows
                             for line in _numbers(f"from_{n}_{i} + shift_{n}", rank, f"_{n}_{i}", self._unit(n))),
                    *(f"  let w_{n}_{r} = {' + '.join(f'share_{n}_{i} * b_{n}_{i}_{r}' for i in rows)};"
                      for r in range(rank))]
        return [shift, *(f"  var w_{n}_{r} = {self.kind(n)}(0.0);" for r in range(rank)),
                f"  for (var i = 0u; i < members_{n}; i++) {{", f"  let share = share_{n}[i];",
                *_numbers(f"from_{n}[i] + shift_{n}", rank),
                *(f"  w_{n}_{r} += share * b_{r};" for r in range(rank)), "  }"]

    def kind(self, n: int) -> str:
        """Type of the weights of a mode."""
        return "Value" if n == self.colour else "f32"

    def _contraction(self) -> list[str]:
        """`total`: the core times its weights, the mode with the colours outermost."""
        outer, inner = self._split()
        kind = "Value" if self.tinted or self.colour in outer else "f32"
        even = not self.contracted and all(self.stride(n) % 2 == 0 for n in outer) and prod(self.ranks) % 2 == 0
        lines = [f"  var list_{n} = array<{self.kind(n)}, {self.ranks[n]}>("
                  f"{', '.join(f'w_{n}_{r}' for r in range(self.ranks[n]))});" for n in outer]
        at = " + ".join(["core", *(f"e_{n} * {self.stride(n)}u" for n in outer)])
        block, value = _Block(self, even).written(inner)
        if not outer:
            return [*lines, f"  let at = {at};", *block, f"  let total = Value({value});"]
        lines.append(f"  var total = {kind}(0.0);")
        lines += [f"  for (var e_{n} = 0u; e_{n} < {self.ranks[n]}u; e_{n}++) {{" for n in outer]
        weight = " * ".join(f"list_{n}[e_{n}]" for n in outer)
        return [*lines, f"  let at = {at};", *block, f"  total += {weight} * {value};", *("  }" for _ in outer)]

    def _split(self) -> tuple[list[int], list[int]]:
        """Modes that are looped over, and modes whose numbers are written out."""
        modes = sorted(self.kept, key=lambda n: n != self.colour)
        inner: list[int] = []
        for n in reversed(modes):
            if inner and (self.single or prod(self.ranks[m] for m in inner) * self.ranks[n] > _UNROLLED):
                break
            inner.insert(0, n)
        return modes[: len(modes) - len(inner)], inner


@dataclass(frozen=True)
class _Block:
    """The core numbers of some modes at `at`, multiplied out; `even`: `at` is, so that numbers come in pairs."""

    cells: Cells
    even: bool

    def written(self, modes: Sequence[int]) -> tuple[list[str], str]:
        """Statements that read the numbers, and the expression of their sum."""
        offsets = [0]
        for n in modes:
            offsets = [offset + e * self.cells.stride(n) for offset in offsets for e in range(self.cells.ranks[n])]
        if self.cells.contracted:
            lines = [f"  let h_{offset} = core_number(at + {offset}u);" for offset in sorted(offsets)]
        elif self.even:
            pairs = sorted({offset // 2 for offset in offsets})
            lines = ["  let pairs = at >> 1u;",
                     *(f"  let p_{pair} = unpack2x16float(word(pairs + {pair}u));" for pair in pairs)]
        else:
            lines = [f"  let h_{offset} = coefficient(at + {offset}u);" for offset in sorted(offsets)]
        return lines, self._sum(modes, 0)

    def _sum(self, modes: Sequence[int], offset: int) -> str:
        if not modes:
            paired = self.even and not self.cells.contracted
            return f"p_{offset // 2}.{'xy'[offset % 2]}" if paired else f"h_{offset}"
        n, rest = modes[0], modes[1:]
        terms = (f"w_{n}_{e} * {self._sum(rest, offset + e * self.cells.stride(n))}"
                 for e in range(self.cells.ranks[n]))
        return f"({' + '.join(terms)})"


def _numbers(at: str, count: int, name: str = "", unit: int = 1) -> list[str]:
    """Statements that read `count` neighbouring float16 numbers as `b{name}_0` and so on; `unit` halves an address."""
    if count == 1:
        return [f"  let b{name}_0 = coefficient({at});"]
    words = (count + 1) // 2
    lines = [f"  let a{name} = {at};", f"  let h{name} = a{name}{' >> 1u' if unit == 1 else ''};",
             *(f"  let q{name}_{k} = unpack2x16float(word(h{name} + {k}u));" for k in range(words))]
    if count % 2 == 0:  # rows of an even length begin at whole words
        return [*lines, *(f"  let b{name}_{r} = q{name}_{r // 2}.{'xy'[r % 2]};" for r in range(count))]
    halves = [f"q{name}_{k}.{part}" for k in range(words) for part in "xy"]
    return [*lines, f"  let odd{name} = (a{name} & 1u) == 1u;",
            *(f"  let b{name}_{r} = select({halves[r]}, {halves[r + 1]}, odd{name});" for r in range(count))]
