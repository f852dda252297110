"""`hmkcta decompress`: the whole array back, written in slabs, under its name only when it is complete."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, BinaryIO

import click
import numpy as np

from ..errors import invalid
from ..hmkfile import check_output, published
from ..hmkfile.reasons import fault
from ..model import Model
from ..model import open as open_model
from ..support.memory import available_memory, check_memory, format_bytes
from ..support.slabs import slabs
from ..transform import nearest
from .options import (
    Command,
    Count,
    OutputFile,
    apart,
    file_argument,
    json_option,
    memory_option,
    overwrite_option,
    quiet_option,
    verbose_option,
)
from .output import emit, seconds
from .progress import Progress

EXAMPLES = ("hmkcta decompress wood.hmk -o wood.npy", "hmkcta decompress wood.hmk -o coarse.npy --level 1",
            "hmkcta decompress jet.hmk -o jet.raw", "hmkcta decompress film.hmk -o film.npy --source-type")

#: Elements decoded at once, and bytes of memory that takes for each.
SLAB, BYTES_AN_ELEMENT = 1 << 22, 20
SMALLEST_SLAB = 1 << 14


@click.command("decompress", cls=Command, examples=EXAMPLES)
@file_argument
@click.option("-o", "--output", required=True, type=OutputFile(), metavar="OUT",
              help="OUT.npy, or OUT.raw for numbers alone.")
@click.option("--level", type=Count(1), metavar="N", help="Decode levels 1 to N only.")
@click.option("--source-type", is_flag=True, help="Numbers of the source's type, integers rounded, instead of float32.")
@memory_option
@overwrite_option
@json_option
@quiet_option
@verbose_option
def decompress_command(file: str, output: str, level: int | None, source_type: bool, max_memory: int | None,
                       overwrite: bool, as_json: bool, quiet: bool, verbose: bool) -> None:
    """Decode FILE into an array of float32 or of the source's type, C order, little-endian."""
    del verbose
    if Path(output).suffix not in (".npy", ".raw"):
        raise invalid("output-format", "output", repr(output), "a name that ends with .npy or .raw")
    check_output(output, overwrite)
    apart(file, output)
    model = open_model(file)
    model = model if level is None else model.at_level(level)
    slab = _slab(model, max_memory)
    kind = np.dtype(model.metadata.source_dtype if source_type else np.float32).newbyteorder("<")
    nbytes = kind.itemsize * model.size
    _check_room(output, nbytes)
    with Progress(quiet or as_json) as progress, published(output, overwrite) as target:
        if output.endswith(".npy"):
            header = {"descr": kind.str, "fortran_order": False, "shape": model.shape}
            np.lib.format.write_array_header_1_0(target, header)
        _write(model, target, kind, slab, progress)
    report: dict[str, Any] = {"output": output, "shape": list(model.shape), "dtype": kind.name, "bytes": nbytes,
                              "seconds": round(progress.elapsed, 3)}
    if as_json:
        emit(report)
    elif not quiet:
        shape = ",".join(map(str, model.shape))
        click.echo(f"{output}: {shape} {kind.name}, {format_bytes(nbytes)}, in {seconds(progress.elapsed)}")


def _slab(model: Model, max_memory: int | None) -> int:
    """Elements to decode at once within the memory."""
    limit = available_memory() if max_memory is None else max_memory
    least = min(SMALLEST_SLAB, model.size) * BYTES_AN_ELEMENT
    check_memory(least, "a slab of the output", "allow more with --max-memory", limit)
    return SLAB if limit is None else min(SLAB, limit // BYTES_AN_ELEMENT)


def _check_room(output: str, needed: int) -> None:
    """A full disk is found before the work, where the system tells."""
    free = shutil.disk_usage(Path(output).resolve().parent).free
    if needed > free:
        most = format_bytes(free)
        raise fault("disk-full", output, format_bytes(needed), most, "free some space",
                    told=f"takes {format_bytes(needed)}, and {most} of the disk are free")


def _write(model: Model, target: BinaryIO, kind: np.dtype[Any], slab: int, progress: Progress) -> None:
    done = 0
    for part in slabs(model.shape, slab):
        values = model[part]
        target.write(np.ascontiguousarray(values if kind == "<f4" else nearest(values, kind), kind).data)
        done += values.size
        progress("decoding", done / model.size)
