"""The viewer's page and one file on loopback: nothing else is served, to nobody else.

The page is everybody's who finds the port; the file is for whoever has the token of the address, which is new each
time. It is opened once: a link that leads elsewhere later changes nothing of what is served.
"""

from __future__ import annotations

import os
import secrets
import tempfile
import threading
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from html import escape
from importlib import resources
from importlib.resources.abc import Traversable
from io import FileIO
from numbers import Integral
from pathlib import Path
from types import TracebackType
from urllib.parse import quote

from numpy.typing import ArrayLike

from .errors import HmkctaError, Kind, expect
from .hmkfile import encode, is_hmk, load_open, open_regular
from .loopback import HOST, Held, Listener, Resource
from .packed import Metadata
from .readers import open_array
from .support.progress import Progress
from .verbatim import check_shape, verbatim

PAGE = "viewer_page"

TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
         ".css": "text/css; charset=utf-8"}


class Server:
    r"""A running server, which `serve` and `view` make; a context manager that ends it.

    Args:
        page: what is served to everybody, by path.
        files: what is served to whoever has the token, by path.
        query: what the page's address says, after the token.
        port: 0 takes a free one.

    Attributes:
        url: of the page that shows the file. Who knows it reads the file.
        token: the part of `url` that is secret.
        port: on which 127.0.0.1 is listened to.

    >>> import tempfile, urllib.request
    >>> from hmkcta import Model
    >>> from hmkcta._example import example_level, example_metadata
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Model(example_metadata(), [example_level()]).save(f"{folder}/small.hmk")
    ...     with serve(f"{folder}/small.hmk", page={"/": Resource("text/html", data=b"page")}) as server:
    ...         request = urllib.request.Request(
    ...             f"http://127.0.0.1:{server.port}/files/small.hmk",
    ...             headers={"Range": "bytes=0-3", "Authorization": f"Bearer {server.token}"})
    ...         urllib.request.urlopen(request).read()
    b'\x89HMK'
    """

    def __init__(self, page: Mapping[str, Resource], files: Mapping[str, Resource], query: str, port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        self._server = Listener(page, files, self.token, port)
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}/?token={self.token}&{query}"
        self._doorway: tempfile.TemporaryDirectory[str] | None = None
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        self.close()

    def close(self) -> None:
        """Stop answering, and free the port."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        if self._doorway is not None:
            self._doorway.cleanup()

    def wait(self) -> None:
        """Wait while it serves, until it is closed from another thread or Ctrl-C interrupts (`KeyboardInterrupt`)."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def open_browser(self) -> bool:
        """Open the page in the browser; whether one could be.

        The browser is given a file that only this user can read and that leads on: commands and their arguments, which
        would have the token in them, are seen by everybody on the computer.
        """
        with suppress(webbrowser.Error, OSError):
            if self._doorway is None:
                self._doorway = tempfile.TemporaryDirectory(prefix="hmkcta-")
            door = Path(self._doorway.name, "view.html")
            there = escape(self.url)
            door.write_text(f"<!doctype html><title>hmkcta</title><meta http-equiv=refresh content='0;url={there}'>"
                            f"<a href='{there}'>Show the file</a>\n", encoding="utf-8")
            return webbrowser.open(door.as_uri())
        return False


def serve(path: str | os.PathLike[str], *, original: str | os.PathLike[str] | ArrayLike | None = None,
          nan: float | None = None, port: int = 0, page: Mapping[str, Resource] | None = None,
          progress: Progress | None = None) -> Server:
    """Serve the viewer and a file on 127.0.0.1.

    Args:
        path: the `.hmk` file. It is opened and checked here as `hmkcta.open` does; the page checks it again. A file
            that takes its name later is not served.
        original: what to compare with: an array of the model's shape, or what NumPy makes one of; a file that
            `hmkcta.open_array` opens as one; or another `.hmk` file of that shape, whatever its axes are called.
        nan: value that stands for NaN and infinity in the original.
        port: 0 takes a free one.
        page: the page's files by path; by default the one that is installed.
        progress: called with a stage's name and the fraction of it done, while the original is unpacked. What it raises
            ends the call before anything is served.

    Returns:
        The running server; its `url` shows the file until it is closed.

    Raises:
        HmkctaError: the file cannot be read or is no `.hmk` file, as `hmkcta.open` has it; the original does not fit,
            the port is taken, or the page was not built.

    >>> import tempfile
    >>> from hmkcta import Model
    >>> from hmkcta._example import example_level, example_metadata
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Model(example_metadata(), [example_level()]).save(f"{folder}/small.hmk")
    ...     with serve(f"{folder}/small.hmk", page={"/": Resource("text/html", data=b"page")}) as server:
    ...         server.url == f"http://127.0.0.1:{server.port}/?token={server.token}&file=files/small.hmk"
    True
    """
    expect("path", path, str | os.PathLike, "the path of an .hmk file", "save the model first: model.save(path)")
    expect("port", port, Integral, "a whole number")
    name = Path(path).name
    metadata, held = _held(path)
    files = {f"/files/{name}": Resource("application/octet-stream", held=held)}
    # The page reads a parameter, and takes what it reads for an address: the name is quoted for both.
    query = "file=" + quote("files/" + quote(os.fsencode(name), safe=" "))
    try:
        shown = page if page is not None else installed_page()
        if original is not None:
            files["/original/original.hmk"] = _original(metadata, original, nan, progress)
            query += "&original=original/original.hmk"
        return Server(shown, files, query, port)
    except BaseException:
        for file in files.values():
            file.close()
        raise


def view(path: str | os.PathLike[str], *, original: str | os.PathLike[str] | ArrayLike | None = None,
         nan: float | None = None, port: int = 0, browser: bool = True, progress: Progress | None = None) -> Server:
    """Serve a file and open the page in the browser; the server runs until it is closed or the program ends.

    Args:
        path: the `.hmk` file.
        original: what to compare with, as `serve` takes it.
        nan: as `serve` takes it.
        port: 0 takes a free one.
        browser: whether to open it.
        progress: as `serve` takes it.

    Returns:
        The running server, as of `serve`.

    Raises:
        HmkctaError: as `serve`, before a browser is opened.

    >>> view("no-such-file.hmk")
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: no-such-file.hmk: cannot be read: No such file or directory. [Io/unreadable]
    """
    server = serve(path, original=original, nan=nan, port=port, progress=progress)
    if browser:
        server.open_browser()
    return server


def installed_page() -> dict[str, Resource]:
    """The files of the page that came with the package, by the path under which they are served.

    Raises:
        HmkctaError: `Io`, reason ``page-missing``: a clone whose page was never built.
    """
    folder = resources.files("hmkcta").joinpath(PAGE)
    if not folder.joinpath("index.html").is_file():
        raise HmkctaError(Kind.IO, "page-missing", "viewer page", found="no built page in this installation",
                          allowed="the page that wheels carry",
                          hint="run `make page` in the clone, with Node 20.19 or later, or install a wheel")
    table = {f"/{name}": Resource(TYPES[Path(name).suffix], data=item.read_bytes())
             for name, item in _files(folder, "") if Path(name).suffix in TYPES}
    table["/"] = table["/index.html"]
    return table


def _files(folder: Traversable, prefix: str) -> list[tuple[str, Traversable]]:
    found: list[tuple[str, Traversable]] = []
    for item in folder.iterdir():
        name = f"{prefix}{item.name}"
        found += _files(item, f"{name}/") if item.is_dir() else [(name, item)]
    return found


def _original(
    like: Metadata, original: str | os.PathLike[str] | ArrayLike, nan: float | None, progress: Progress | None
) -> Resource:
    """The original as a file that the page's decoder reads."""
    if isinstance(original, str | os.PathLike):
        if is_hmk(original):
            metadata, held = _held(original)
            try:
                check_shape(tuple(axis.size for axis in metadata.axes), like)
            except HmkctaError:
                held.close()
                raise
            return Resource("application/octet-stream", held=held)
        original = open_array(os.fspath(original), progress=progress)
    metadata, level = verbatim(original, like, nan)
    return Resource("application/octet-stream", data=b"".join(encode(metadata, (level,))))


def _held(path: str | os.PathLike[str]) -> tuple[Metadata, Held]:
    """A file's metadata, and the file itself: what was checked is what is served."""
    file: FileIO = open_regular(path)
    try:
        return load_open(file, path)[0], Held(file)
    except BaseException:
        file.close()
        raise
