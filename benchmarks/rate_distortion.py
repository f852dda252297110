"""SNR at a byte budget and a decode cost: hmkcta beside peers with random access, and codecs without.

``python benchmarks/rate_distortion.py DATA`` takes every ``.npz`` of the folder DATA with an array `values`; without
DATA the folder that `HMKCTA_BENCH_DATA` names, else what `hmkcta.synthetic` makes. It prints a markdown table, writes
a row for each fit as CSV, and draws the curves beside it as PNG. ``--methods hmkcta hosvd_bricks`` measures these
alone; rows of the others stay in the CSV as they are.

Everyone gets the same bytes: a share of the float32 bytes plus an allowance for header and tables. hmkcta is charged
for the whole file. Peers (`peers/`) are quantised and entropy coded by one rate model, and keep to the same decode
cost. Codecs (`codecs.py`) decode everything or nothing.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "python")]

import hmkcta  # noqa: E402 - found through the path above
from benchmarks import peers  # noqa: E402
from benchmarks.codecs import CODECS, TTHRESH_VARIABLE, Missing, best_within  # noqa: E402
from benchmarks.curves import draw  # noqa: E402
from benchmarks.data import SHEET_VARIABLE  # noqa: E402
from hmkcta import synthetic  # noqa: E402
from hmkcta.axes import format_organisation  # noqa: E402
from hmkcta.cli.layout import blocks_text, layout_of  # noqa: E402
from hmkcta.metrics import snr_db  # noqa: E402
from hmkcta.model import Model  # noqa: E402

F32 = NDArray[np.float32]

OURS = "hmkcta"
METHODS = (OURS, *peers.METHODS, *CODECS)
#: Shares of the float32 bytes, bytes on top for header and tables, and multiply-adds for one element.
RATES, ALLOWANCE, DECODE_COST = (400, 100, 30), 8192, 4096
RESULTS = Path(__file__).parent / "results" / "rate_distortion.csv"
#: Axes of the public sets that the README's table is of.
AXES = {
    "fmri_volume": ("time", "z", "y", "x"),
    "icon_multilight": ("light", "y", "x", "rgb"),
    "shop_lightfield": ("row", "column", "y", "x", "rgb"),
    "viscous_fingers_volume": ("time", "z", "y", "x"),
}


@dataclass(frozen=True)
class Row:
    """One fit.

    Attributes:
        data: name of the set.
        rate: 100: a budget of 1/100 of the float32 bytes, and the allowance.
        budget: bytes.
        method: who.
        snr_db: of the values as decoded.
        bytes: used; of hmkcta the whole file.
        decode_cost: multiply-adds of one element at the most; 0: everything is decoded.
        seconds: processor time; of a peer's search for all budgets of the run together.
        detail: the layout.
        machine: processor and cores.
    """

    data: str
    rate: int
    budget: int
    method: str
    snr_db: float
    bytes: int
    decode_cost: int
    seconds: float
    detail: str
    machine: str


def sets(folder: Path | None, wanted: Sequence[str]) -> Iterator[tuple[str, F32, tuple[str, ...]]]:
    """Name, values and axes of the data sets: all, or those whose name begins with a wanted word."""
    if folder is None:
        makers: dict[str, Callable[[], synthetic.Dataset]] = {
            "material": lambda: synthetic.material(16, 12, 48),
            "light_field": lambda: synthetic.light_field(7, 64, 4),
            "volume": lambda: synthetic.volume(40, 16),
        }
        for name, make in makers.items():
            if not wanted or name.startswith(tuple(wanted)):
                made = make()
                yield name, np.ascontiguousarray(made.values, np.float32), tuple(made.names)
        return
    for path in sorted(folder.glob("*.npz")):
        if not wanted or path.stem.startswith(tuple(wanted)):
            with np.load(path) as archive:
                values = archive["values"] if "values" in archive.files else None
            if values is not None:
                yield path.stem, np.ascontiguousarray(values, np.float32), _axes(path.stem, values.ndim)


def _axes(name: str, count: int) -> tuple[str, ...]:
    known = AXES.get(name, ())
    return known if len(known) == count else tuple(f"axis{number}" for number in range(count))


def measure(
    name: str,
    values: F32,
    rates: Sequence[int],
    allowance: int = ALLOWANCE,
    threads: int | None = None,
    methods: Sequence[str] = (OURS, *peers.METHODS),
    axes: Sequence[str] | None = None,
) -> Iterator[Row]:
    """Each method on one data set at all budgets, in the order of the methods; none where nothing fits."""
    axes = axes or _axes(name, values.ndim)
    budgets = {rate: values.nbytes // rate + allowance for rate in rates}
    energy, machine = float(np.square(values, dtype=np.float64).sum()), f"{platform.machine()}, {os.cpu_count()} cores"

    def row(rate: int, method: str, snr: float, nbytes: int, cost: int, seconds: float, detail: str) -> Row:
        return Row(name, rate, budgets[rate], method, round(snr, 3), nbytes, cost, round(seconds, 1), detail, machine)

    for method in methods:
        start = time.process_time()
        if method == OURS:
            for rate, budget in budgets.items():
                start = time.process_time()
                model = hmkcta.compress(values, size=budget, decode_cost=DECODE_COST, threads=threads, axes=list(axes))
                yield row(rate, method, model.snr, model.nbytes, model.decode_cost, time.process_time() - start,
                          described(model))
        elif method in peers.METHODS:
            found = peers.best_of(method, values, list(budgets.values()), DECODE_COST, axes)
            for rate, one in zip(rates, found, strict=True):
                if one is not None:
                    error, nbytes, cost, detail = one
                    yield row(rate, method, snr_db(energy, error), nbytes, cost, time.process_time() - start, detail)
        else:
            for rate, budget in budgets.items():
                start = time.process_time()
                within = best_within(CODECS[method], values, budget)
                if within is not None:
                    yield row(rate, method, snr_db(energy, within[0]), within[1], 0, time.process_time() - start, "")


def described(model: Model) -> str:
    """The layout that was found: merged axes, blocks, modes that some blocks leave undecomposed, the largest ranks."""
    names = [format_organisation((mode,)) for mode in model.metadata.organisation]
    layout = layout_of(model)[-1]
    whole = Counter({" and ".join(found["modes"]): found["nodes"] for found in layout["undecomposed"]})
    whole.pop("", None)
    undecomposed = f"; undecomposed {', '.join(f'{name} in {count}' for name, count in whole.items())}" if whole else ""
    ranks = ", ".join(map(str, model.bounds[-1].ranks))
    return f"modes {', '.join(names)}; {blocks_text(layout['blocks'], names)}{undecomposed}; ranks <= {ranks}"


def markdown(rows: Sequence[Row]) -> str:
    """A line for each data set and budget: ours, the best peer, by how much we are better, and any best codec."""
    with_codecs = any(row.method in CODECS for row in rows)
    names = ["data", "budget", "hmkcta", "decode cost", "best peer", "decode cost", "difference"]
    names += ["best codec"] * with_codecs
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    for (data, rate), group in groupby(rows, key=lambda row: (row.data, row.rate)):
        fits = list(group)
        ours = next((row for row in fits if row.method == OURS), None)
        if ours is None:
            continue
        cells = [data, f"1/{rate}, {ours.budget / 1024:.0f} KiB", f"{ours.snr_db:.2f} dB", str(ours.decode_cost)]
        peer = _best(fits, peers.METHODS)
        cells += ["", "", ""] if peer is None else [
            f"{peer.method} {peer.snr_db:.2f} dB", str(peer.decode_cost), f"{ours.snr_db - peer.snr_db:+.2f} dB"]
        if with_codecs:
            codec = _best(fits, CODECS)
            cells.append("" if codec is None else f"{codec.method} {codec.snr_db:.2f} dB")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _best(rows: Sequence[Row], methods: Any) -> Row | None:
    return max((row for row in rows if row.method in methods), key=lambda row: row.snr_db, default=None)


def ordered(rows: Sequence[Row]) -> list[Row]:
    """Rows by set, by budget, and by method; of those measured twice the last."""
    found = {(row.data, row.rate, row.method): row for row in rows}
    return sorted(found.values(), key=lambda row: (row.data, -row.rate, METHODS.index(row.method)))


def write(rows: Sequence[Row], path: Path) -> None:
    """Write the rows as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read(path: Path = RESULTS) -> list[Row]:
    """The rows of a CSV that `write` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Row(
                row["data"],
                int(row["rate"]),
                int(row["budget"]),
                row["method"],
                float(row["snr_db"]),
                int(row["bytes"]),
                int(row["decode_cost"]),
                float(row["seconds"]),
                row["detail"],
                row["machine"],
            )
            for row in csv.DictReader(file)
        ]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("data", nargs="?", type=Path,
                        help=f"folder of .npz files; default: ${SHEET_VARIABLE}, else synthetic data")
    parser.add_argument("--sets", nargs="*", default=[], help="only sets whose names begin so")
    parser.add_argument("--rates", nargs="*", type=int, default=RATES, help="400: 1/400 of the float32 bytes")
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=METHODS, help="only these; default: all")
    parser.add_argument("--allowance", type=int, default=ALLOWANCE, help="bytes on top, for everyone (8192)")
    parser.add_argument("--threads", type=int, help="threads of our fits; default: all cores")
    parser.add_argument("--tthresh", help=f"TTHRESH's program; default: ${TTHRESH_VARIABLE}, or what is on the path")
    parser.add_argument("-o", "--output", type=Path, help="CSV to write; default: in benchmarks/results")
    return parser.parse_args()


def main() -> None:
    """Measure, print, write, draw."""
    given = _arguments()
    if given.tthresh:
        os.environ[TTHRESH_VARIABLE] = given.tthresh
    folder = given.data or (Path(os.environ[SHEET_VARIABLE]) if os.environ.get(SHEET_VARIABLE) else None)
    output = given.output or (RESULTS if folder else RESULTS.with_stem("rate_distortion-synthetic"))
    rows = read(output) if output.exists() else []
    missing: set[str] = set()
    for name, values, axes in sets(folder, given.sets):
        for method in (method for method in given.methods if method not in missing):
            try:
                for row in measure(name, values, given.rates, given.allowance, given.threads, [method], axes):
                    rows = ordered([*rows, row])
                    write(rows, output)  # after each, so that an interruption loses little
                    sys.stderr.write(f"{name} 1/{row.rate}, {method}: {row.snr_db:.2f} dB, {row.seconds:.0f} cpu-s\n")
            except Missing as failed:
                missing.add(method)
                sys.stderr.write(f"{method} is left out: {failed}\n")
    draw([(row.data, row.method, row.bytes, row.snr_db) for row in rows], METHODS, output.with_suffix(".png"))
    sys.stdout.write(markdown(rows) + "\n")


if __name__ == "__main__":
    main()
