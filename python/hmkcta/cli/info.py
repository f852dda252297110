"""`hmkcta info`: all there is to know about a file without its source."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import click
import numpy as np

from ..axes import format_organisation
from ..hmkfile import level_bytes
from ..model import Model
from ..model import open as open_model
from ..packed import PackedLevel, undecomposed_modes
from ..plan import multiply_adds
from ..support.memory import format_bytes
from .layout import layout_lines, layout_of
from .options import Command, file_argument, json_option, verbose_option
from .output import decibels, emit, number_bits, share, shown_bits, table, transformed_column

EXAMPLES = ("hmkcta info wood.hmk", "hmkcta info wood.hmk --json", "hmkcta info wood.hmk -v")


@click.command("info", cls=Command, examples=EXAMPLES)
@file_argument
@json_option
@verbose_option
def info_command(file: str, as_json: bool, verbose: bool) -> None:
    """Show axes, levels, quality and sizes of FILE, whose checksums are verified."""
    report = describe(open_model(file), os.path.getsize(file), level_bytes(file))
    if as_json:
        emit({"file": file, **report})
    else:
        click.echo(file)
        click.echo(as_text(report, verbose))


def describe(model: Model, size: int, sizes: Sequence[int]) -> dict[str, Any]:
    """The facts of a model whose file has `size` bytes, of which each level takes what `sizes` says."""
    metadata = model.metadata
    source_bytes = model.size * np.dtype(metadata.source_dtype).itemsize
    return {
        "kind": metadata.kind,
        "source_dtype": metadata.source_dtype,
        "axes": [{"name": axis.name, "size": axis.size, "role": axis.role, "unit": axis.unit,
                  "coordinates": axis.coords is not None} for axis in metadata.axes],
        "organisation": format_organisation(metadata.organisation),
        "undecomposed": list(undecomposed_modes(model.stages)),
        "transform": metadata.transform,
        "levels": [{**_level(model, number, own, size - sum(sizes[number:])), "layout": layout}
                   for number, (own, layout) in enumerate(zip(sizes, layout_of(model), strict=True), 1)],
        "layout": layout_lines(model),
        "decode_cost": model.decode_cost,
        "bytes": {"file": size, "levels": sum(sizes), "header": size - sum(sizes)},
        "ratio": source_bytes / size,
        "source": metadata.source, "seed": metadata.seed, "writer": metadata.writer,
    }


def _level(model: Model, number: int, own: int, upto: int) -> dict[str, Any]:
    """The facts of a level: `own` are its bytes, `upto` those that are read to decode it, with all above it."""
    bounds, level, quality = model.bounds[number - 1], model.levels[number - 1], model.quality[number - 1]
    cells, zero_cells = cells_of(level)
    return {
        "level": number, "R": list(bounds.ranks), "C": list(bounds.clusters), "K": list(bounds.mixture),
        "bits": number_bits(level, own), "subdivision": bounds.scheme,
        "nodes": level.nodes, "nodes_that_carry_nothing": int((~level.shape.any(axis=(1, 2))).sum()),
        "clusters": cells, "clusters_that_carry_nothing": zero_cells,
        "bytes": own, "bytes_upto": upto,
        "snr_db": quality.snr_db, "transformed_snr_db": model.metadata.transformed_snr_db[number - 1],
        "rmse": quality.rmse, "max_abs_error": quality.max_abs_error,
    }


def cells_of(level: PackedLevel) -> tuple[int, int]:
    """Clusters c = (c_1..c_N) of all nodes of a level, and how many of them have a core of zeros.

    >>> from hmkcta._example import example_level
    >>> cells_of(example_level())
    (1, 0)
    """
    shape = level.shape.astype(np.int64)
    alive = level.has_cells
    cells = np.where(alive, shape[:, 0].prod(axis=1), 0)
    lengths = np.repeat(shape[:, 2].prod(axis=1), cells)  # numbers in each cell's core
    if not lengths.size:
        return 0, 0
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    filled = np.maximum.reduceat(level.core != 0, starts)
    return len(lengths), int((~filled).sum())


def _coordinates(axis: dict[str, Any]) -> str:
    unit = f" in {axis['unit']}" if axis["unit"] else ""
    return f", coordinates{unit}" if axis["coordinates"] else ""


def _shape(level: dict[str, Any], undecomposed: Sequence[int]) -> list[str]:
    """R, C, K as a plan has them: * for the rank of a mode that is left undecomposed."""
    ranks = ["*" if n in undecomposed else rank for n, rank in enumerate(level["R"])]
    mixture = [max(1, k) for k in level["K"]]  # 0 in a file, where a mode has no basis
    return [",".join(map(str, numbers)) for numbers in (ranks, level["C"], mixture)]


def as_text(report: dict[str, Any], verbose: bool) -> str:
    """The facts for people."""
    axes = ", ".join(f"{axis['name']} {axis['size']} ({axis['role']}{_coordinates(axis)})" for axis in report["axes"])
    domain, inner = transformed_column(report["transform"]["name"], report["levels"])
    levels = table(
        ["level", "R", "C", "K", "bits", "subdivision", "nodes", "empty", "clusters", "empty", "SNR dB",
         *domain, "RMSE", "max error", "size"],
        [[str(level["level"]), *_shape(level, report["undecomposed"]), shown_bits(level["bits"]),
          level["subdivision"], str(level["nodes"]), str(level["nodes_that_carry_nothing"]),
          str(level["clusters"]), str(level["clusters_that_carry_nothing"]),
          decibels(level["snr_db"]), *of_transformed, f"{level['rmse']:.4g}", f"{level['max_abs_error']:.4g}",
          format_bytes(level["bytes"])] for level, of_transformed in zip(report["levels"], inner, strict=True)],
        "  ", left=[1, 2, 3, 5])
    parts = report["bytes"]
    transform = report["transform"]["name"] + "".join(
        f", {key} {value:g}" for key, value in report["transform"].items() if key != "name")
    lines = [
        f"  {report['kind']}, source {report['source_dtype']}, written by {report['writer'] or 'unknown'}, "
        f"seed {report['seed']}",
        f"  axes          {axes}",
        f"  organisation  {report['organisation']}",
        *(f"  layout        {line}" for line in report["layout"]),
        f"  transform     {transform}",
        f"  decode cost   {multiply_adds(report['decode_cost'])} an element",
        f"  size          {format_bytes(parts['file'])}, {share(report['ratio'])} the source: levels "
        f"{format_bytes(parts['levels'])}, header {format_bytes(parts['header'])}",
        "", levels,
    ]
    if verbose:
        lines += ["", *(f"  source {key}: {value}" for key, value in report["source"].items())]
    return "\n".join(lines)

