"""Whole fits, each in a process of its own for its peak memory to be its own: ``python -m benchmarks.compressing``."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.report import Row
from hmkcta.support.memory import peak_memory

#: Axes and organisation of the paper's tensors.
SHEET = ("light,view,y,x,rgb", "light+rgb, view, y, x")
VOLUME = ("time,z,y,x", "time, z, y, x")

WH2 = "R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2"
WH4 = "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2"
WM1 = "R=2,2,3,3 C=12,9,16,16 K=2"
#: Plans for fits without and with a GPU: high ranks, overlapping clusters, disjoint ones, and several levels.
FOR_GPU = {"HOSVD, R=32": "R=32,16,32,32", "MK-CTA, K=2": "R=6,6,8,8 C=4,3,4,4 K=2", "CTA, K=1": "R=4 C=4,3,4,4 K=1",
           "WH4": WH4}  # fmt: skip
#: Table 4 with modes in the order of the array: the paper has x, y, z, time.
TVVD = "R=*,2,2,2 / R=*,1,1,1 C=1,8,6,6 K=1,2,2,2 / R=*,1,1,1 C=1,8,6,6 K=1,2,2,2"


@dataclass(frozen=True)
class Case:
    """One fit: `backfits` rounds of back-fitting by the otherwise default effort, most bytes of memory if limited.

    `device` is where the kernels work.
    """

    name: str
    path: str
    plan: str
    data: tuple[str, str]
    backfits: int
    threads: int
    memory: int | None = None
    device: str = "cpu"


def run(case: Case, data: str) -> Row:
    """Compress in a new process, after the file has been dropped from the system's cache: what is read is counted."""
    _forget(Path(case.path))
    command = [sys.executable, "-m", "benchmarks.compressing", json.dumps(asdict(case))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True, env=environment)
    result = json.loads(done.stdout.splitlines()[-1])
    detail = f"{data}, {case.backfits} back-fit rounds"
    return Row(case.name, detail, case.threads, result["seconds"], result["processor"], result["elements"],
               read=result["read"], memory=result["memory"], snr=result["snr"], size=result["size"])


def _forget(path: Path) -> None:
    if hasattr(os, "posix_fadvise"):
        with path.open("rb") as file:
            os.fsync(file.fileno())
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _fit(case: Case) -> dict[str, float | int | None]:
    import hmkcta
    from hmkcta.fitting import fit
    from hmkcta.readers import open_array

    fit.EFFORTS["medium"] = replace(fit.EFFORTS["medium"], backfits=case.backfits)
    source = open_array(case.path)
    start, before = time.perf_counter(), _read()
    model = hmkcta.compress(
        source, case.plan, axes=case.data[0].split(","), organisation=case.data[1], scheme="most",
        threads=case.threads, max_memory=case.memory, progress=_progress, device=case.device,
    )  # fmt: skip
    seconds, used = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF)
    read = None if before is None else (_read() or 0) - before
    sys.stderr.write(f"\n{case.name}: levels {[round(q.snr_db, 2) for q in model.quality]} dB\n")
    return {
        "seconds": seconds, "processor": used.ru_utime + used.ru_stime, "elements": model.size, "read": read,
        "memory": peak_memory(), "snr": model.snr, "size": model.nbytes,
    }  # fmt: skip


def _progress(stage: str, fraction: float) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{stage}: {100 * fraction:.0f} %   ")


def _read() -> int | None:
    """Bytes this process has had read from storage, where the system counts them."""
    try:
        lines = Path("/proc/self/io").read_text().splitlines()
        return int(next(line.split()[1] for line in lines if line.startswith("read_bytes")))
    except (OSError, StopIteration):
        return None


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_fit(Case(**json.loads(sys.argv[1])))) + "\n")
