"""The part of a prelude that decodes a model of one cell, as PCA and HOSVD make: no tree, no clusters, no rows kept.

Every mode's weights are its basis rows, weighted and added up in a loop for each of its axes; then comes the core. It
takes the place of `weighted.wgsl`, costs less and compiles in half the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from .tree import Tree

#: For each source axis its mode, and by how many rows of the mode an index counts.
Places = tuple[Sequence[int], Sequence[int]]

#: Numbers of a core's last mode that are written out one by one; more are looped over.
_UNROLLED = 8


def is_single(tree: Tree) -> bool:
    """Whether the model is one cell."""
    stages = tree.metadata.stages
    return len(stages) == 1 and tree.uniform == (0,) and set(stages[0].clusters) == {1}


def single_cell(tree: Tree, places: Places, colour: int | None, contracted: Sequence[int], tinted: bool
                ) -> list[str]:
    """`decode_picked(stages)`, where `is_single`.

    Args:
        tree: what is known of the model.
        places: from `axis_places`.
        colour: the mode whose weights are colours.
        contracted: modes that are summed into the core already.
        tinted: whether the contracted core holds colours.
    """
    modes = [n for n in range(tree.order) if n not in contracted]
    cell = _Cell(tree, places, colour, sorted(modes, key=lambda n: n != colour), bool(contracted), tinted)
    weights = [line for n in modes for line in cell.weights(n)]
    return ["fn decode_picked(stages: u32) -> Value {", *weights, *cell.core(),
            "  return bitcast<f32>(word(word(2u))) * total;", "}"]


@dataclass(frozen=True)
class _Cell:
    """The cell; `modes` in the order of the loops over the core."""

    tree: Tree
    places: Places
    colour: int | None
    modes: Sequence[int]
    framed: bool
    tinted: bool

    @property
    def ranks(self) -> Sequence[int]:
        return self.tree.metadata.stages[0].ranks

    def weights(self, n: int) -> list[str]:
        """`w_n`: the basis rows of mode n, weighted and added up; those of a colour count in its channel only."""
        if n in self.tree.undecomposed:
            return []
        rank, tint = self.ranks[n], self._tint(n)
        lines = [f"  let basis_{n} = word({3 + 5 * n + 4}u);",
                 f"  var w_{n}: array<{'f32' if tint is None else 'Value'}, {rank}>;", "  {", *self._rows(n)]
        if tint is None:
            lines += [f"  let at = basis_{n} + row * {rank}u;", *_added(n, rank)]
        else:
            lines += [f"  let at_{c} = basis_{n} + (row + {self._index(tint, f'{c}u')}) * {rank}u;" for c in range(3)]
            numbers = ", ".join(f"coefficient(at_{c} + e)" for c in range(3))
            lines += [f"  for (var e = 0u; e < {rank}u; e++) {{", f"  w_{n}[e] += share * vec3f({numbers});", "  }"]
        return [*lines, *("  }" for _ in self._axes(n)), "  }"]

    def core(self) -> list[str]:
        """`total`: the core times its weights, each mode added up before it is multiplied."""
        if not self.modes:
            return ["  let total = core_number(node_core(0u));"]
        return ["  let at_0 = node_core(0u);", *self._nest(0), "  let total = Value(sum_0);"]

    def _tint(self, n: int) -> int | None:
        """The axis of the colours, if it is in mode n and weights are colours."""
        axes = self.tree.metadata.axes
        found = (axis for axis, mode in enumerate(self.places[0]) if mode == n and axes[axis].role == "channel")
        return next(found, None) if n == self.colour else None

    def _axes(self, n: int) -> list[int]:
        """The axes of mode n, but for that of the colours."""
        return [axis for axis, mode in enumerate(self.places[0]) if mode == n and axis != self._tint(n)]

    def _index(self, axis: int, k: str) -> str:
        """By how many rows pick k of an axis counts."""
        return f"pick_index[{axis}u * PICKS + {k}] * {self.places[1][axis]}u"

    def _rows(self, n: int) -> list[str]:
        """Loops over the picks of a mode's axes, with `row` and `share`."""
        axes = self._axes(n)
        row = " + ".join([self._index(axis, f"i_{axis}") for axis in axes] or ["0u"])
        share = " * ".join([f"pick_weight[{axis}u * PICKS + i_{axis}]" for axis in axes] or ["1.0"])
        return [*(f"  for (var i_{axis} = 0u; i_{axis} < pick_count[{axis}]; i_{axis}++) {{" for axis in axes),
                f"  let row = {row};", f"  let share = {share};"]

    def _nest(self, k: int) -> list[str]:
        """`sum_k` over the k-th mode and all behind it, of the numbers from `at_k` on."""
        n = self.modes[k]
        kind = "Value" if self.tinted or (k == 0 and n == self.colour) else "f32"
        rank, stride = self.ranks[n], prod(self.ranks[m] for m in self.modes if m > n)
        inner = self._nest(k + 1) if k + 1 < len(self.modes) else [f"  let sum_{k + 1} = core_number(at_{k + 1});"]
        head = f"  var sum_{k} = {kind}(0.0);"
        if n in self.tree.undecomposed:
            tint = self._tint(n)
            if tint is None:
                return [head, *self._rows(n), f"  let at_{k + 1} = at_{k} + row * {stride}u;", *inner,
                        f"  sum_{k} += share * sum_{k + 1};", *("  }" for _ in self._axes(n))]
            return [head, *self._rows(n), "  for (var c = 0u; c < 3u; c++) {",
                    f"  let at_{k + 1} = at_{k} + (row + {self._index(tint, 'c')}) * {stride}u;", *inner,
                    f"  sum_{k} += share * sum_{k + 1} * channel(c);", "  }", *("  }" for _ in self._axes(n))]
        if k + 1 < len(self.modes):
            return [head, f"  for (var e_{k} = 0u; e_{k} < {rank}u; e_{k}++) {{",
                    f"  let at_{k + 1} = at_{k} + e_{k} * {stride}u;", *inner,
                    f"  sum_{k} += w_{n}[e_{k}] * sum_{k + 1};", "  }"]
        step = 2 if stride == 1 and rank % 2 == 0 and not self.framed else 1
        if rank <= _UNROLLED:
            return [head, *(line for e in range(0, rank, step) for line in self._terms(k, f"{e}u", step, stride))]
        return [head, f"  for (var e = 0u; e < {rank}u; e += {step}u) {{", *self._terms(k, "e", step, stride), "  }"]

    def _terms(self, k: int, e: str, step: int, stride: int) -> list[str]:
        """Statements that add one or two neighbouring numbers of the last mode."""
        n = self.modes[k]
        if step == 1:
            return [f"  sum_{k} += w_{n}[{e}] * core_number(at_{k} + {e} * {stride}u);"]
        pair = f"unpack2x16float(word((at_{k} + {e}) >> 1u))"
        return [f"  sum_{k} += dot(vec2f(w_{n}[{e}], w_{n}[{e} + 1u]), {pair});"]


def _added(n: int, rank: int) -> list[str]:
    """Statements that add the row at `at` times `share` to `w_n`, by words where rows begin at whole ones."""
    if rank % 2:
        return [f"  for (var e = 0u; e < {rank}u; e++) {{", f"  w_{n}[e] += share * coefficient(at + e);", "  }"]
    return [f"  for (var e = 0u; e < {rank}u; e += 2u) {{",
            "  let pair = share * unpack2x16float(word((at + e) >> 1u));",
            f"  w_{n}[e] += pair.x;", f"  w_{n}[e + 1u] += pair.y;", "  }"]
