"""Output files that are never half there: written beside the target, forced to the disk, then given its name."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import DISK_FULL
from ..support.recordlog import Busy, claim
from ..support.temporaries import temporary
from .reasons import fault


def check_output(path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """The file that `path` leads to, if a new one may be put there: asked before hours of work, and again after them.

    Raises:
        HmkctaError: `Io`, with the reason ``output-exists`` or ``unwritable``.
    """
    with _as_io(str(path)):
        target = _resolved(path)
        # What a link in /proc leads to has no path, yet is there.
        exists, regular = os.path.exists(path) or target.exists(), os.path.isfile(path)
        if exists and not (overwrite and regular):
            allowed = "a new file" if not overwrite else "a file, or nothing"
            instead = ", or replace it by overwrite=True or --overwrite" if regular else ""
            raise fault("output-exists", str(target), "a file" if regular else "no regular file", allowed,
                        f"choose another name{instead}",
                        told="is there already" if regular else "is there already, and no regular file")
        if not target.parent.is_dir():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(target.parent))
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target.parent))
    return target


@contextmanager
def published(path: str | os.PathLike[str], overwrite: bool = False) -> Generator[BinaryIO]:
    """A file to write; it gets its name when the block ends, and is removed without a trace if that fails.

    Raises:
        HmkctaError: `Io` if the output is there already (``output-exists``), the disk is full (``disk-full``) or the
            folder cannot be written to (``unwritable``). The target is then as it was.
    """
    target = check_output(path, overwrite)
    with _as_io(str(path)):
        remove_stale(target)
        beside = target.with_name(f"{_before(target)}{secrets.token_hex(8)}.tmp")
        try:
            with temporary(beside), _claimed(beside) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            check_output(target, overwrite)  # another writer may have been faster
            os.replace(beside, target)
        except BaseException:  # an interrupted writer leaves nothing behind either
            with suppress(OSError):
                beside.unlink(missing_ok=True)
            raise
        _sync_folder(target.parent)


def remove_stale(path: str | os.PathLike[str]) -> None:
    """Remove what writers of this output left beside it that were killed; whatever is still written stays."""
    target = _resolved(path)
    before = re.compile(re.escape(_before(target)) + r"[0-9a-f]{16}\.tmp")
    for name in os.listdir(target.parent):
        if before.fullmatch(name):
            with suppress(OSError, Busy), open(target.with_name(name), "r+b") as file:
                if claim(file.fileno()):
                    target.with_name(name).unlink()


def _claimed(path: Path) -> BinaryIO:
    """A new file, locked, by which others know that somebody writes it."""
    while True:
        file = open(path, "xb")  # noqa: SIM115 (the caller closes it)
        with suppress(Busy):
            claim(file.fileno())
            if path.exists():
                return file
        file.close()  # somebody has taken it for a stale one before it was locked
        path.unlink(missing_ok=True)


def _before(target: Path) -> str:
    """How the names of unfinished files of an output begin."""
    return f".{target.name[:40]}."


def _resolved(path: str | os.PathLike[str]) -> Path:
    """The path without links: a link keeps pointing to what it points to."""
    try:
        return Path(os.fsdecode(os.path.realpath(path)))
    except ValueError as error:  # a zero byte in it
        raise OSError(errno.EINVAL, str(error)) from error


def _sync_folder(folder: Path) -> None:
    """Force the new name to the disk; only POSIX lets a folder be opened for that."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _as_io(path: str) -> Generator[None]:
    """Turn what the operating system says into an `Io` error."""
    try:
        yield
    except OSError as error:
        full = error.errno in DISK_FULL
        said = error.strerror or error
        raise fault("disk-full" if full else "unwritable", path, said, "a folder with room for it",
                    "free some space" if full else "check the folder and its permissions",
                    told=f"cannot be written: {said}") from error
