"""`hmkcta verify`: is the file whole, and is it as good as it says?"""

from __future__ import annotations

from collections.abc import Sequence
from math import isclose
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind
from ..measure import measure_both
from ..model import Model
from ..model import open as open_model
from ..packed import LevelQuality
from ..streaming.steady import fingerprint_of
from ..support.cut_short import whole_map
from .compared import opened
from .options import (
    Command,
    file_argument,
    json_option,
    nan_option,
    quiet_option,
    source_options,
    verbose_option,
)
from .output import decibels, emit, table, transformed_column
from .progress import Progress

EXAMPLES = ("hmkcta verify wood.hmk", "hmkcta verify wood.hmk --against wood.npy",
            "hmkcta verify jet.hmk --against jet.raw --shape 64,64,64 --dtype float32")

#: How far measurements may differ from the file's: sums are float64 in another order, and where no level is above
#: 40 dB (`measure.FINE`) values are decoded in float32.
SNR_TOLERANCE, ERROR_TOLERANCE = 0.01, 1e-3


@click.command("verify", cls=Command, examples=EXAMPLES)
@file_argument
@click.option("--against", metavar="SRC", help="Source: measure again, compare with FILE.")
@source_options
@nan_option
@json_option
@quiet_option
@verbose_option
def verify_command(file: str, against: str | None, nan: float | None, as_json: bool, quiet: bool, verbose: bool,
                   **source: Any) -> None:
    """Check FILE; with --against SRC also that it was made from SRC, and is as good as it says.

    Exit code 4: FILE is damaged, or its quality is not what it says. 9: SRC is another array, however near.
    """
    del verbose
    model = open_model(file)
    report: dict[str, Any] = {"file": file, "digests": "ok", "structure": "ok"}
    measured = tuple[LevelQuality, ...]()
    watched = opened("--against", against, source, quiet or as_json)
    made_from = None
    if watched is not None:
        array = watched.array
        with Progress(quiet or as_json) as progress, whole_map(array):
            measured, transformed = measure_both(model, array, nan=nan, progress=progress)
            found = fingerprint_of(array)
            made_from = _is_source(model, array, found)
            watched.check(found)
        report["levels"] = _report(model, measured, transformed)
        report["made_from_source"] = made_from
    if not as_json and not quiet:
        _show(file, model, report.get("levels", []))
    advice = "check that the values that were replaced get the same ones, by --nan" if made_from else (
        f"give the source it was made from: {against} has other values (their SHA-256 differ)")
    for number, (said, found) in enumerate(zip(model.quality, measured, strict=False), start=1):
        _compare(file, number, said, found, advice)
    if made_from is False:
        raise _other_source(str(against), file, model, measured)
    if as_json:
        emit(report)


def _is_source(model: Model, array: NDArray[Any], fingerprint: str | None) -> bool | None:
    """Whether the model was made from these values, of whatever number type; None: it does not say."""
    said = model.metadata.source.get("sha256")
    if said is None or said == fingerprint:
        return None if said is None else True
    made_of = np.dtype(model.metadata.source_dtype)
    return made_of != array.dtype.newbyteorder("=") and fingerprint_of(array, made_of) == said


def _other_source(source: str, file: str, model: Model, measured: Sequence[LevelQuality]) -> HmkctaError:
    """The error for values that differ from those of the source, however near they are."""
    found, said = measured[-1], model.quality[-1]
    figures = (f"against it SNR is {decibels(found.snr_db)} dB and the largest error {found.max_abs_error:.4g}, "
               f"{file} says {decibels(said.snr_db)} dB and {said.max_abs_error:.4g}")
    return HmkctaError(Kind.OTHER_SOURCE, "source-differs", source,
                       told=f"not the array {file} was made from (their SHA-256 differ); {figures}",
                       hint="give the source it was made from, or compress this one")


def _report(
    model: Model, measured: tuple[LevelQuality, ...], transformed: tuple[LevelQuality, ...]
) -> list[dict[str, Any]]:
    """The SNR of transformed values is null where there is no transform, as `compress --json` has it."""
    changed = model.metadata.is_transformed
    return [{"level": number, "snr_db": found.snr_db, "transformed_snr_db": inner.snr_db if changed else None,
             "rmse": found.rmse, "max_abs_error": found.max_abs_error, "snr_db_in_file": said.snr_db}
            for number, (said, found, inner) in enumerate(zip(model.quality, measured, transformed, strict=True), 1)]


def _show(file: str, model: Model, levels: Sequence[dict[str, Any]]) -> None:
    click.echo(f"{file}: digests, indices and numbers are as they should be.")
    if not levels:
        return
    domain, inner = transformed_column(model.metadata.transform["name"], levels)
    rows = [[str(level["level"]), decibels(level["snr_db"]), decibels(level["snr_db_in_file"]),
             *of_transformed, f"{level['rmse']:.4g}", f"{level['max_abs_error']:.4g}"]
            for level, of_transformed in zip(levels, inner, strict=True)]
    header = ["level", "SNR dB", "in the file", *domain, "RMSE", "max error"]
    click.echo(table(header, rows))


def _compare(file: str, number: int, said: LevelQuality, found: LevelQuality, advice: str) -> None:
    """Refuse a file whose quality is another than it says."""
    snr_agrees = said.snr_db == found.snr_db or abs(said.snr_db - found.snr_db) <= SNR_TOLERANCE
    rows = (
        ("SNR", snr_agrees, f"{found.snr_db:.4f} dB", f"{said.snr_db:.4f} dB"),
        ("RMSE", _close(found.rmse, said.rmse), f"{found.rmse:.6g}", f"{said.rmse:.6g}"),
        ("largest error", _close(found.max_abs_error, said.max_abs_error),
         f"{found.max_abs_error:.6g}", f"{said.max_abs_error:.6g}"),
    )
    for name, agrees, measured, stated in rows:
        if not agrees:
            raise HmkctaError(Kind.CORRUPTION, "quality-differs", f"{name} of level {number} of {file}",
                              found=measured, allowed=f"{stated}, as the file says", hint=advice)


def _close(found: float, said: float) -> bool:
    return isclose(found, said, rel_tol=ERROR_TOLERANCE)
