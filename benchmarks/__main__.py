"""``python -m benchmarks [small|paper|kernels|decode|gpu|profile]``: measure, print, write to benchmarks/results.

`small` (the default) takes minutes; `paper` makes the data of the paper's sizes in a scratch folder (8 GB, kept for the
next time) and takes an hour or two; `gpu` fits without and with an NVIDIA GPU; `profile` only tells where the time of a
fit goes. The rate-distortion table is a program of its own, `benchmarks/rate_distortion.py`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks import compressing, data, decoding, kernels, stages
from benchmarks.compressing import FOR_GPU, SHEET, TVVD, VOLUME, WH2, WH4, WM1, Case
from benchmarks.machine import limits
from benchmarks.report import RESULTS, Row, write
from hmkcta.backends import Device, find_device

#: Peak memory that fits of the paper's sizes may take: under a quarter of the tensor.
MEMORY = 1600 * 10**6


def main() -> None:
    """Measure and write."""
    given = _arguments()
    if given.set == "profile":
        sys.stdout.write(_profile(given))
        return
    device = _device("cuda" if given.set == "gpu" else given.device)
    count = given.threads or os.cpu_count() or 1
    threads = sorted({1, count})
    machine = limits(threads)
    scratch = _scratch(given)
    sets: dict[str, Callable[[], Iterator[Row]]] = {
        "kernels": lambda: kernels.rows(
            list(kernels.NODES), threads[:1] if device else threads, readable=given.reference, device=device),
        "decode": lambda: decoding.rows(threads),
        "small": lambda: _small(scratch, given.data, threads),
        "gpu": lambda: _on_gpu(scratch, given.data, count),
        "paper": lambda: _paper(scratch, given.data, threads, given.only),
    }
    rows: list[Row] = []
    for row in sets[given.set]():
        rows.append(row)
        write(rows, machine, given.set, given.output)  # after each, so that an interruption loses little
        sys.stderr.write(f"{row.what}, {row.detail}, {row.threads}: {row.seconds:.3g} s\n")
    sys.stdout.write(write(rows, machine, given.set, given.output).read_text(encoding="utf-8"))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0], prog="python -m benchmarks")
    parser.add_argument("set", nargs="?", default="small",
                        choices=["small", "paper", "kernels", "decode", "gpu", "profile"])  # fmt: skip
    parser.add_argument("--threads", type=int, help="beside one thread; default: all cores")
    parser.add_argument("--data", type=Path, help=f"folder with {data.SHEET_FILE}; default: ${data.SHEET_VARIABLE}")
    parser.add_argument("--scratch", type=Path, help="where data is made; default: a folder for temporary files")
    parser.add_argument("--output", type=Path, default=RESULTS, help="where the tables go")
    parser.add_argument("--only", nargs="*", default=[], help="paper: only cases whose names begin so")
    parser.add_argument("--reference", action="store_true", help="kernels: the NumPy reference (slow)")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu", help="kernels: on an NVIDIA GPU")
    return parser.parse_args()


def _device(name: str) -> Device | None:
    """The GPU; None: the CPU. There is nothing to measure where one is missing."""
    device = find_device(name)
    if device.missing:
        raise SystemExit(device.missing)
    if device.name == "cpu":
        return None
    sys.stderr.write(f"{device.described}\n")
    return device


def _scratch(given: argparse.Namespace) -> Path:
    return given.scratch or Path(tempfile.gettempdir()) / "hmkcta-benchmarks"


def _profile(given: argparse.Namespace) -> str:
    """WH4 on the sheet, small."""
    path = _scratch(given) / "sheet-64.npy"
    data.sheet(path, 64, 60, given.data)
    return stages.profile(Case("profile", str(path), WH4, SHEET, backfits=1, threads=1))


def _small(scratch: Path, folder: Path | None, threads: list[int]) -> Iterator[Row]:
    """Kernels, decoding, and fits of small data by the paper's plans."""
    yield from kernels.rows(kernels.SMALL, threads)
    yield from decoding.rows(threads, elements=1 << 19, lights=4)
    path = scratch / "sheet-64.npy"
    name = data.sheet(path, 64, 60, folder)
    for plan, backfits in ((WH2, 0), (WH4, 0), (WH4, 2)):
        label = "WH2" if plan == WH2 else "WH4"
        yield compressing.run(Case(f"compress, {label}", str(path), plan, SHEET, backfits=backfits,
                                   threads=threads[-1]), f"{name}, 58 x 58 x 64 x 60 rgb")
    path = scratch / "volume-64.npy"
    name = data.turbulence(path, (52, 64, 64), 20)
    yield compressing.run(Case("compress, TVVD", str(path), TVVD, VOLUME, backfits=0, threads=threads[-1]),
                          f"{name}, 20 x 52 x 64 x 64")


def _on_gpu(scratch: Path, folder: Path | None, threads: int) -> Iterator[Row]:
    """Fits by plans with large levels, on the CPU alone and with a GPU."""
    path = scratch / "sheet-96.npy"
    name = data.sheet(path, 96, 90, folder)
    for label, plan in FOR_GPU.items():
        for device in ("cpu", "cuda"):
            case = Case(f"compress, {label}, {device}", str(path), plan, SHEET, 0, threads, device=device)
            yield compressing.run(case, f"{name}, 58 x 58 x 96 x 90 rgb")


def _paper(scratch: Path, folder: Path | None, threads: list[int], only: list[str]) -> Iterator[Row]:
    """Fits at the paper's sizes, and decoding of such a model."""
    count = threads[-1]
    path = scratch / "sheet-400.npy"
    fits = [("WH2", WH2, 0), ("WH2", WH2, 2), ("WH4", WH4, 0), ("WH4", WH4, 2), ("WM1", WM1, 0)]
    wanted = [fit for fit in fits if not only or fit[0].startswith(tuple(only))]
    name = data.sheet(path, 400, 380, folder) if wanted else ""
    for label, plan, backfits in wanted:
        memory = None if plan == WM1 else MEMORY  # flat MK-CTA keeps its residual in memory
        case = Case(f"compress, {label}", str(path), plan, SHEET, backfits=backfits, threads=count, memory=memory)
        yield compressing.run(case, f"{name}, 58 x 58 x 400 x 380 rgb")
    if not only or "TVVD".startswith(tuple(only)):
        path = scratch / "volume-258.npy"
        name = data.turbulence(path, (208, 258, 258), 40)
        case = Case("compress, TVVD", str(path), TVVD, VOLUME, backfits=0, threads=count, memory=MEMORY)
        yield compressing.run(case, f"{name}, 40 x 208 x 258 x 258")
    if not only or "decode".startswith(tuple(only)):
        yield from decoding.rows(threads)


if __name__ == "__main__":
    main()
