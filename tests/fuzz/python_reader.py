"""The Python reader as a process: mutants come on standard input, what it says of each goes to standard output.

A mutant is preceded by its length in four bytes; an answer is a line of JSON: `reason` (`ok` if the file is taken),
`kind`, `escape` (an exception that is none of the project's), `seconds` (of the processor, as the machine may be at
other work), `mebibytes` (by how much the largest memory of the process grew) and `lines` (lines of the reader that were
run for the first time).

    python -m fuzz.python_reader MEBIBYTES
"""

from __future__ import annotations

import json
import resource
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from time import process_time
from types import FrameType
from typing import Any, BinaryIO

import numpy as np

import hmkcta
from hmkcta import Model
from hmkcta.axes import mode_sizes
from hmkcta.decode import decode_elements
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import loads

PACKAGE = str(Path(hmkcta.__file__).parent)
#: Of so many mutants the lines of one are looked at, as that takes five times longer than reading it.
LOOKED_AT = 8
#: Elements of a file that is taken up to which all are decoded.
DECODED = 1 << 14


class Lines:
    """Which lines of the package were run.

    Python 3.11 has no cheaper way; a line costs its time until it was seen, then only its function's call.
    """

    def __init__(self) -> None:
        self._seen = dict[Any, set[int]]()
        self._new = 0

    def __enter__(self) -> Lines:
        self._new = 0
        sys.settrace(self._called)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    @property
    def new(self) -> int:
        """Lines since the block was entered that no block before had."""
        return self._new

    def _called(self, frame: FrameType, event: str, _: object) -> Any:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(PACKAGE):
            return None
        lines = self._seen.get(code)
        if lines is None:
            lines = self._seen[code] = {line for *_, line in code.co_lines() if line is not None}

        def stepped(_: FrameType, event: str, __: object, left: set[int] = lines) -> Any:
            if event == "line" and frame.f_lineno in left:
                left.discard(frame.f_lineno)
                self._new += 1
            return stepped

        return stepped if lines else None


def read(data: bytes) -> str:
    """Read a file and decode something of it; `ok`, or the error of the project's."""
    metadata, levels = loads(data)
    model = Model(metadata, levels)
    corner = np.zeros((1, len(metadata.organisation)), np.intp)
    values = decode_elements(levels, mode_sizes(metadata.axes, metadata.organisation), corner)
    if 0 < model.size <= DECODED:
        values = model[...]
    if not np.isfinite(values).all():
        raise ArithmeticError("a file that is taken decodes to numbers that are not finite")
    return "ok"


def answer(data: bytes, lines: Lines | None) -> dict[str, Any]:
    """What is said of a mutant."""
    before, begun, said = _peak(), process_time(), dict[str, Any](reason="ok", kind="", escape="")
    try:
        with lines or nullcontext():
            read(data)
    except HmkctaError as error:
        said |= {"reason": error.reason, "kind": error.kind.label}
    except BaseException as error:  # what is none of the project's is what is looked for
        said["escape"] = f"{type(error).__name__}: {error}"[:300]
    new = lines.new if lines else 0
    return {**said, "seconds": process_time() - begun, "mebibytes": _peak() - before, "lines": new}


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def frames(source: BinaryIO) -> Any:
    """The mutants of a stream."""
    while len(head := source.read(4)) == 4:
        yield source.read(int.from_bytes(head, "little"))


def main(mebibytes: int) -> None:
    """Answer until the input ends."""
    with suppress(AttributeError, OSError, ValueError):  # not everywhere
        held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        most = held + (mebibytes + 1024 << 20)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    lines = Lines()
    for number, data in enumerate(frames(sys.stdin.buffer)):
        sys.stdout.write(json.dumps(answer(data, None if number % LOOKED_AT else lines)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]))
