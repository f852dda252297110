"""Readers in processes of their own, which may die or not answer."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent
VIEWER = ROOT / "viewer"
#: Seconds after which a reader that says nothing is ended.
PATIENCE = 20.0


@dataclass(frozen=True)
class Answer:
    """What a reader says of a file."""

    reason: str  # "ok" if it takes it
    kind: str = ""
    escape: str = ""  # an exception that is none of the project's, or how the process ended
    seconds: float = 0.0  # of the processor
    mebibytes: float = 0.0  # by how much its largest memory grew
    lines: int = 0  # of its code that were run for the first time

    @property
    def verdict(self) -> str:
        """Kind and reason together."""
        return f"{self.kind}/{self.reason}" if self.kind else self.reason


class Reader:
    """A process that answers each mutant; another one takes its place when it ends.

    Args:
        command: what is started.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._words: BytesIO | FileIO = BytesIO()

    def send(self, data: bytes) -> None:
        """Hand it a mutant; `answer` waits for what it says."""
        if self._process is None:
            descriptor, name = tempfile.mkstemp()
            os.unlink(name)
            self._words = FileIO(descriptor, "r+")
            paths = os.pathsep.join([str(ROOT / "python"), str(ROOT / "tests")])
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._words,
                env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"})
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(len(data).to_bytes(4, "little") + data)
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # what it died of is seen when it does not answer

    def answer(self) -> Answer:
        """What it says of the mutant."""
        process = self._process
        assert process is not None
        assert process.stdout is not None
        with selectors.DefaultSelector() as ready:
            ready.register(process.stdout, selectors.EVENT_READ)
            hung = not ready.select(PATIENCE)
        line = b"" if hung else process.stdout.readline()
        if line:
            found: dict[str, Any] = json.loads(line)
            return Answer(**found)
        process.kill()
        process.wait()
        self._words.seek(0)
        words = self._words.read().decode(errors="replace").split("\n")
        error = next((word.strip() for word in words if "rror" in word), "")
        self.close()
        ended = "no answer" if hung else f"the process ended with {process.returncode}: {error}"
        return Answer("ended", escape=ended, seconds=PATIENCE if hung else 0.0)

    def close(self) -> None:
        """End the process; the next mutant begins another one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()
            self._words.close()


def python_reader(mebibytes: int) -> Reader:
    """The reader of the package."""
    return Reader([sys.executable, "-m", "fuzz.python_reader", str(mebibytes)])


def viewer_reader(bundle: Path) -> Reader:
    """The reader of the viewer, of a bundle that `bundled` made."""
    return Reader(["node", "--max-old-space-size=1024", str(bundle)])


def bundled(folder: Path) -> Path | None:
    """The viewer's reader as one JavaScript file; None where there is no Node, or its packages were not installed."""
    made, tool = folder / "verdicts.mjs", VIEWER / "node_modules" / ".bin" / "rolldown"
    try:
        subprocess.run([str(tool), "tests/verdicts.ts", "--format", "esm", "--platform", "node", "--file", str(made)],
                       cwd=VIEWER, check=True, capture_output=True, timeout=120)
    except (OSError, subprocess.CalledProcessError):
        return None
    return made
