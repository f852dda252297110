"""Files that must not outlive the process, for the one way of ending it that runs no clean-up.

Whoever makes such a file removes it himself. An interrupted command line that can wait no longer removes the rest.
"""

from __future__ import annotations

import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

_paths: set[Path] = set()


@contextmanager
def temporary(path: Path) -> Generator[Path]:
    """While the block runs, a file or folder there may be removed by `remove_all`.

    >>> with temporary(Path("scratch")) as path:
    ...     path in _paths
    True
    >>> Path("scratch") in _paths
    False
    """
    _paths.add(path)
    try:
        yield path
    finally:
        _paths.discard(path)


def remove_all() -> None:
    """Remove what is there still; what cannot be removed stays."""
    for path in list(_paths):
        with suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
