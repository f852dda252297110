"""One figure a row: CSV for machines, a markdown table for people, and how far each is from the machine's limits."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Limits:
    """What the machine can do, measured in the same run: bytes copied (read and written) and flops of a large product.

    Attributes:
        name: processor and cores.
        copy: bytes a second that all threads are busy, by number of threads.
        sgemm: flops, likewise.
    """

    name: str
    copy: dict[int, float]
    sgemm: dict[int, float]


@dataclass(frozen=True)
class Row:
    """One measured figure; what a benchmark has no number for is None.

    Attributes:
        what: the benchmark.
        detail: of which variant.
        threads: how many.
        seconds: wall seconds.
        processor: processor seconds of all threads.
        elements: elements worked on; of kernels that visit an element once for every cell, elements, not visits.
        flops: useful floating-point operations: those of the formula, zeros and padding not counted.
        moved: bytes that must move between memory and processor at the least.
        read: bytes read from storage; None where nothing is.
        memory: peak resident bytes of a process of its own.
        snr: dB, of a fit.
        size: bytes of the file, of a fit.
    """

    what: str
    detail: str
    threads: int
    seconds: float
    processor: float
    elements: float
    flops: float | None = None
    moved: float | None = None
    read: int | None = None
    memory: int | None = None
    snr: float | None = None
    size: int | None = None

    @property
    def rate(self) -> float:
        """Elements a second."""
        return self.elements / self.seconds

    @property
    def busy(self) -> float:
        """Seconds with all threads busy: what the limits are compared by, since a machine may have other users.

        Whether the threads were busy shows in `processor` beside `seconds`.
        """
        return self.processor / self.threads

    def of_sgemm(self, limits: Limits) -> float | None:
        """Share of the sgemm rate of as many threads."""
        return None if self.flops is None else self.flops / self.busy / limits.sgemm[self.threads]

    def of_copy(self, limits: Limits) -> float | None:
        """Share of the copy bandwidth of as many threads."""
        return None if self.moved is None else self.moved / self.busy / limits.copy[self.threads]


def write(rows: Sequence[Row], limits: Limits, name: str, folder: Path = RESULTS) -> Path:
    """Write `name`.csv and `name`.md; returns the path of the table."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [field.name for field in fields(Row)] + ["rate", "of_sgemm", "of_copy", "machine"]
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        for row in rows:
            shares = {"of_sgemm": row.of_sgemm(limits), "of_copy": row.of_copy(limits)}
            entries = asdict(row) | {"rate": row.rate, **shares, "machine": limits.name}
            writer.writerow({key: _short(value) for key, value in entries.items()})
    path = folder / f"{name}.md"
    path.write_text(markdown(rows, limits), encoding="utf-8")
    return path


def markdown(rows: Sequence[Row], limits: Limits) -> str:
    """The machine's limits in a sentence, and a table; columns that no row fills are left out."""
    machine = "; ".join(
        f"{threads} {'thread' if threads == 1 else 'threads'}: copy {limits.copy[threads] / 1e9:.1f} GB/s, "
        f"sgemm {limits.sgemm[threads] / 1e9:.0f} GFLOP/s"
        for threads in sorted(limits.copy)
    )
    columns = {
        "benchmark": [row.what for row in rows],
        "variant": [row.detail for row in rows],
        "threads": [str(row.threads) for row in rows],
        "seconds": [f"{row.seconds:.3g}" for row in rows],
        "cpu-s": [f"{row.processor:.3g}" for row in rows],
        "M elements/s": [f"{row.rate / 1e6:.3g}" for row in rows],
        "of sgemm": [_percent(row.of_sgemm(limits)) for row in rows],
        "of copy": [_percent(row.of_copy(limits)) for row in rows],
        "read MiB": [_mebibytes(row.read) for row in rows],
        "peak MiB": [_mebibytes(row.memory) for row in rows],
        "SNR dB": ["" if row.snr is None else f"{row.snr:.2f}" for row in rows],
        "file MiB": [_mebibytes(row.size, 2) for row in rows],
    }
    kept = {name: cells for name, cells in columns.items() if any(cells)}
    lines = ["| " + " | ".join(kept) + " |", "|" + " --- |" * len(kept)]
    lines += ["| " + " | ".join(cells) + " |" for cells in zip(*kept.values(), strict=True)]
    return f"{limits.name}. {machine}.\n\n" + "\n".join(lines) + "\n"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.0f} %"


def _mebibytes(count: int | None, digits: int = 0) -> str:
    return "" if count is None else f"{count / 2**20:.{digits}f}"


def _short(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value
