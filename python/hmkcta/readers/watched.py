"""A source that must stay as it is from its opening until what is made of it is complete."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import HmkctaError, source_changed
from ..streaming.steady import fingerprint_of, stamp_of
from .open_array import open_array
from .source import watched_by
from .zarr_store import is_zarr

#: What is seen of a file or folder; None: it is not there.
_State = str | None


class WatchedSource:
    """An array with the files and folders that it was read from, whatever their format.

    Args:
        uri: and the others: as `open_array` takes them.

    Attributes:
        array: the array.
        gone: whether, at the last check, a file was no longer there; the array is what it was then.

    Raises:
        HmkctaError: what `open_array` raises; `SourceChanged`, where a file changed while it was unpacked.
    """

    def __init__(self, uri: str, **how: Any) -> None:
        self._uri, self._how = uri, how
        self.gone = False
        self.array = self._opened()

    def check(self, fingerprint: str | None) -> None:
        """Look whether all files are what they were; where one is not, open the source anew and compare all values.

        Args:
            fingerprint: of the values that were worked on, `fingerprint_of`; None: any other state is a change.

        Raises:
            HmkctaError: `SourceChanged`, reason ``source-changed``.
        """
        changed = self._changed()
        self.gone = any(_state(path) is None for path in changed)
        if not changed or self.gone:
            return
        try:
            found = fingerprint_of(self._opened())
        except HmkctaError as error:
            raise _change(changed) from error
        if found != fingerprint:
            raise _change(changed)

    def _opened(self) -> NDArray[Any]:
        self._states: dict[Path, _State] = {}
        with watched_by(self._note):
            array = open_array(self._uri, **self._how)
        if changed := self._changed():
            raise _change(changed)
        return array

    def _note(self, path: Path) -> None:
        if path not in self._states:
            self._states[path] = _state(path)

    def _changed(self) -> list[Path]:
        return [path for path, state in self._states.items() if _state(path) != state]


def _change(paths: list[Path]) -> HmkctaError:
    others = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return source_changed("source-changed", f"{paths[0]}{others}", "changed while the source was read")


def _state(path: Path) -> _State:
    """A word for the state of a file; of a Zarr store for that of all its files, of any other folder for its list."""
    stamp = stamp_of(path)
    if stamp is None or not os.path.isdir(path):
        return None if stamp is None else repr(stamp)
    digest = hashlib.sha256()
    for line in sorted(_stored(path) if is_zarr(path) else os.listdir(path)):
        digest.update(os.fsencode(line) + b"\0")
    return digest.hexdigest()


def _stored(folder: Path) -> Iterator[str]:
    for place, _, names in os.walk(folder):
        for name in names:
            yield f"{os.path.join(place, name)} {stamp_of(os.path.join(place, name))}"

