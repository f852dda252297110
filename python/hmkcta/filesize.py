"""What a file will take, told by its plan: every array's length and the whole header, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import isinf, prod

from ._version import __version__
from .axes import Axis, Organisation, mode_sizes
from .fitting.memberships import block_sizes
from .hmkfile import ArrayInfo, coords_info, coords_name, file_size, level_schema, narrowest, prefix
from .hmkfile.stored import stored
from .packed import LevelBounds, LevelQuality, Metadata
from .plan import LevelSpec, Plan
from .streaming.source import Source

#: Stand-in for figures of quality that are not measured yet; the header has room for any.
UNKNOWN = LevelQuality(1.0, 1.0, 1.0)

#: Sizes that the nodes of a level have in one mode. Nodes are all combinations of these, one for each mode.
Parts = list[int]


def metadata_of(
    source: Source,
    plan: Plan,
    levels: Sequence[LevelBounds],
    kind: str,
    seed: int,
    quality: Sequence[LevelQuality] | None = None,
    transformed: Sequence[LevelQuality] | None = None,
) -> Metadata:
    """The metadata of a file that follows the plan; `quality` of the values, `transformed` in the fitted domain."""
    facts = dict(source.fingerprint)
    if not source.value_transform.is_identity:
        measured = [level.snr_db for level in transformed or [UNKNOWN] * len(levels)]
        facts["transformed_snr_db"] = [None if isinf(snr) else round(snr, 6) for snr in measured]
    return Metadata(
        source_dtype=source.dtype,
        axes=source.axes,
        organisation=plan.organisation,
        stages=tuple(levels),
        kind=kind,
        transform=source.transform,
        quality=tuple(map(_rounded, quality or [UNKNOWN] * len(levels))),
        source=facts,
        writer=f"hmkcta {__version__}",
        seed=seed,
    )


def undecomposed_in(plan: Plan) -> tuple[int, ...]:
    """Mode numbers, the same in every level."""
    return tuple(n for n, rank in enumerate(plan.levels[0].ranks) if rank is None)


def _rounded(quality: LevelQuality) -> LevelQuality:
    """A millionth of a dB and seven digits: more are noise, as sums in another order change them."""
    errors = (float(f"{error:.7g}") for error in (quality.rmse, quality.max_abs_error))
    return LevelQuality(round(quality.snr_db, 6), *errors)


def predicted_bytes(plan: Plan, source: Source, kind: str | None = None, seed: int = 0) -> int | None:
    """Bytes of the file; None where they follow from the data, as ranks of each node's own do for an SNR.

    Exact where every node and cluster carries something and nodes found by trial are as large as C and R; a file may
    be smaller where they are not. Of eight-bit numbers the scheme tells: `uniform` takes most.

    >>> import numpy as np
    >>> from hmkcta.plan import parse_plan
    >>> from hmkcta.streaming.source import described
    >>> source = described(np.zeros((72, 24, 96, 96)), ["light", "view", "y", "x"])
    >>> predicted_bytes(parse_plan("R=4,4,6,6", [(axis.name,) for axis in source.axes]), source) // 1024
    9
    """
    if plan.size is not None and plan.levels[-1].own:
        return plan.size
    if plan.levels[-1].own:
        return None
    return planned_bytes(plan, source, kind, seed)


def planned_bytes(plan: Plan, source: Source, kind: str | None = None, seed: int = 0) -> int:
    """Bytes of a file all of whose nodes have the ranks of the plan's levels, as far as their sizes allow."""
    arrays = {name: coords_info(axis) for axis in source.axes if (name := coords_name(axis)) is not None}
    parts: list[Parts] = [[size] for size in mode_sizes(source.axes, plan.organisation)]
    bounds: list[LevelBounds] = []
    for number, level in enumerate(plan.levels, start=1):
        shapes = [[_shape(level, n, size) for size in sizes] for n, sizes in enumerate(parts)]
        schema = _level_arrays(plan, level, parts, shapes, last=number == len(plan.levels))
        arrays |= {prefix(number) + name: info for name, info in schema}
        clusters, mixture, ranks = (tuple(max(shape[of] for shape in mode) for mode in shapes) for of in range(3))
        bounds.append(LevelBounds(clusters, mixture, ranks, level.scheme))
        blocks = _grid_blocks(level, source.axes, plan.organisation) if number == 1 and level.grid else None
        parts = blocks or [
            [part for size, (clusters, _, _) in zip(sizes, mode, strict=True) for part in block_sizes(size, clusters)]
            for sizes, mode in zip(parts, shapes, strict=True)
        ]
    metadata = metadata_of(source, plan, bounds, kind or source.kind, seed)
    return file_size(stored(metadata, undecomposed_in(plan)), arrays)


def _shape(level: LevelSpec, n: int, size: int) -> tuple[int, int, int]:
    """C, K and R of a node in mode n, of which it has `size` rows."""
    clusters, rank = min(level.clusters[n], size), level.ranks[n]
    return clusters, min(level.mixture[n], clusters), size if rank is None else min(rank, size)


def _level_arrays(
    plan: Plan,
    level: LevelSpec,
    parts: Sequence[Parts],
    shapes: Sequence[Sequence[tuple[int, int, int]]],
    *,
    last: bool,
) -> Iterator[tuple[str, ArrayInfo]]:
    """Names and infos of a level's arrays in the order of the schema.

    Its nodes are all combinations of parts, so that sums over nodes are products over modes of sums over parts.
    """
    order = len(parts)
    nodes, cells = prod(map(len, parts)), prod(sum(c for c, _, _ in mode) for mode in shapes)
    lengths = {"core": prod(sum(c * r for c, _, r in mode) for mode in shapes), "core_scale": cells}
    for n, (sizes, mode) in enumerate(zip(parts, shapes, strict=True)):
        others = nodes // len(sizes)
        other_cells = prod(sum(c for c, _, _ in shapes[m]) for m in range(order) if m != n)
        lengths[f"cluster/{n}"] = others * sum(size * k for size, (_, k, _) in zip(sizes, mode, strict=True))
        lengths[f"basis/{n}"] = other_cells * sum(size * k * r for size, (_, k, r) in zip(sizes, mode, strict=True))
        lengths[f"rice/{n}"] = others * sum(r for _, _, r in mode)
        lengths[f"part/{n}"] = lengths[f"local/{n}"] = others * sum(sizes)
    short = plan.levels[-1].bits == 8
    types = _short_types(level, shapes) if short else {}
    packed = level.bits == 8 and level.own and any(level.ranks)
    schema = level_schema(order, undecomposed_in(plan), nodes, last, level.bits, short=short, packed=packed)
    for name, info in schema:
        dtype = types.get(name, info.dtype)
        if dtype is not None:
            yield name, ArrayInfo(dtype, tuple(lengths[name] if size < 0 else size for size in info.shape))


def _short_types(level: LevelSpec, shapes: Sequence[Sequence[tuple[int, int, int]]]) -> dict[str, str | None]:
    """Number types of tables that hang on their numbers, where no float16 is stored; None: they are left out."""
    children = prod(sum(c for c, _, _ in mode) for mode in shapes)
    types: dict[str, str | None] = {"child": narrowest(children)}
    types["shape"] = narrowest(max(number for mode in shapes for shape in mode for number in shape))
    for n, mode in enumerate(shapes):
        c, k = (max(shape[of] for shape in mode) for of in range(2))
        apart = c > 1 and level.scheme == "uniform" and not level.grid  # rows do not go where their clusters are
        types[f"cluster/{n}"] = narrowest(c - 1) if c > 1 else None
        types[f"part/{n}"] = narrowest(c - 1) if k > 1 or apart else None
        types[f"local/{n}"] = None
    return types


def _grid_blocks(level: LevelSpec, axes: Sequence[Axis], organisation: Organisation) -> list[Parts]:
    """Sizes of the parts of each mode that a grid of the whole tensor makes."""
    counts, size = dict(level.grid), {axis.name: axis.size for axis in axes}
    return [
        [prod(blocks) for blocks in product(*(block_sizes(size[name], counts.get(name, 1)) for name in mode))]
        for mode in organisation
    ]
