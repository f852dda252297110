"""SNR at a byte budget and a decode cost: hmkcta beside PCA, clustered PCA, HOSVD and HOSVD bricks.

``python benchmarks/rate_distortion.py DATA`` takes every ``.npz`` of the folder DATA with an array `values`; without
DATA it takes what `hmkcta.synthetic` makes. It prints a markdown table and writes a row for each fit as CSV.

Everyone gets the same bytes: a share of the float32 bytes plus an allowance for header and tables. We are charged for
the whole file, the peers (`tests/baselines.py`) for float16 coefficients and labels only. ``--peers-allowance 0``
leaves the peers the share alone, as they store no header and tables.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "python")]

import hmkcta  # noqa: E402 - found through the path above
from baselines import METHODS  # noqa: E402
from hmkcta import synthetic  # noqa: E402
from hmkcta.axes import format_organisation  # noqa: E402

F32 = NDArray[np.float32]

OURS = "hmkcta"
#: Shares of the float32 bytes, bytes on top for header and tables, and multiply-adds for one element.
RATES, ALLOWANCE, DECODE_COST = (400, 100, 30), 8192, 4096
RESULTS = Path(__file__).parent / "results" / "rate_distortion.csv"


@dataclass(frozen=True)
class Row:
    """One fit."""

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


def sets(folder: Path | None, wanted: Sequence[str]) -> Iterator[tuple[str, F32]]:
    """Names and values of the data sets: all, or those whose name begins with a wanted word."""
    if folder is None:
        makers: dict[str, Any] = {
            "material": lambda: synthetic.material(16, 12, 48),
            "light_field": lambda: synthetic.light_field(7, 64, 4),
            "volume": lambda: synthetic.volume(40, 16),
        }
        found = ((name, lambda make=make: make().values) for name, make in makers.items())
    else:
        found = ((path.stem, lambda path=path: _values(path)) for path in sorted(folder.glob("*.npz")))
    for name, load in found:
        values = load() if not wanted or name.startswith(tuple(wanted)) else None
        if values is not None:
            yield name, np.ascontiguousarray(values, np.float32)


def _values(path: Path) -> NDArray[Any] | None:
    with np.load(path) as archive:
        return archive["values"] if "values" in archive.files else None


def measure(
    name: str,
    values: F32,
    rate: int,
    allowance: int = ALLOWANCE,
    threads: int | None = None,
    peers_allowance: int | None = None,
) -> list[Row]:
    """Every method on one data set at one budget, ours first; peers get our allowance, or one of their own."""
    budget, machine = values.nbytes // rate + allowance, f"{platform.machine()}, {os.cpu_count()} cores"
    theirs = budget if peers_allowance is None else values.nbytes // rate + peers_allowance
    start = time.perf_counter()
    model = hmkcta.compress(values, size=budget, decode_cost=DECODE_COST, threads=threads)
    spent = time.perf_counter() - start
    how = f"{format_organisation(model.metadata.organisation)}: " + " / ".join(
        f"C={','.join(map(str, level.clusters))} R<={','.join(map(str, level.ranks))}" for level in model.bounds
    )
    snr, cost = round(model.snr, 3), model.decode_cost
    rows = [Row(name, rate, budget, OURS, snr, model.nbytes, cost, round(spent, 1), how, machine)]
    for method, fit in METHODS.items():
        start = time.perf_counter()
        found = fit(values, theirs, DECODE_COST)
        spent, snr = round(time.perf_counter() - start, 1), round(found.snr_db, 3)
        rows.append(Row(name, rate, theirs, method, snr, found.nbytes, found.cost, spent, found.detail, machine))
    return rows


def markdown(rows: Sequence[Row]) -> str:
    """A line for each data set and budget: ours, the best peer, and by how much we are better."""
    lines = [
        "| data | budget | hmkcta | decode cost | best peer | decode cost | difference |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (data, rate), group in groupby(rows, key=lambda row: (row.data, row.rate)):
        fits = list(group)
        ours = next(row for row in fits if row.method == OURS)
        peer = max((row for row in fits if row.method != OURS), key=lambda row: row.snr_db)
        lines.append(
            f"| {data} | 1/{rate}, {ours.budget / 1024:.0f} KiB | {ours.snr_db:.2f} dB | {ours.decode_cost} "
            f"| {peer.method} {peer.snr_db:.2f} dB | {peer.decode_cost} | {ours.snr_db - peer.snr_db:+.2f} dB |"
        )
    return "\n".join(lines)


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


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of .npz files; default: synthetic data")
    parser.add_argument("--sets", nargs="*", default=[], help="only sets whose names begin so")
    parser.add_argument("--rates", nargs="*", type=int, default=RATES, help="400: 1/400 of the float32 bytes")
    parser.add_argument("--allowance", type=int, default=ALLOWANCE, help="bytes on top, for everyone (8192)")
    parser.add_argument("--peers-allowance", type=int, help="bytes on top for peers, whose headers are free (ours)")
    parser.add_argument("--threads", type=int, help="threads of our fits; default: all cores")
    parser.add_argument("-o", "--output", type=Path, help="CSV to write; default: in benchmarks/results")
    given = parser.parse_args()
    rows: list[Row] = []
    output = given.output or (RESULTS if given.data else RESULTS.with_stem("rate_distortion-synthetic"))
    for name, values in sets(given.data, given.sets):
        for rate in given.rates:
            rows += measure(name, values, rate, given.allowance, given.threads, given.peers_allowance)
            write(rows, output)
            sys.stderr.write(f"{name} 1/{rate}: {rows[-1 - len(METHODS)].snr_db:.2f} dB\n")
    sys.stdout.write(markdown(rows) + "\n")


if __name__ == "__main__":
    main()
