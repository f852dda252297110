"""The viewer's page and one file on loopback: nothing else is served, to nobody else.

Only 127.0.0.1 is listened on, only names in a fixed table are answered, and only requests that name this host are: a
page of another site can neither read the file nor be pointed at this port by its name server.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from importlib.resources.abc import Traversable
from io import BytesIO
from numbers import Integral
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, cast
from urllib.parse import quote, unquote, urlsplit

from numpy.typing import ArrayLike

from .errors import HmkctaError, Kind, expect
from .hmkfile import encode, is_hmk
from .model import open as open_model
from .packed import Metadata
from .readers import open_array
from .support.progress import Progress
from .verbatim import check_shape, verbatim

HOST = "127.0.0.1"
PAGE = "viewer_page"
CHUNK = 1 << 20

TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
         ".css": "text/css; charset=utf-8"}
#: The page decodes on the GPU, draws what it makes itself, and talks to nobody.
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
          "base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
HEADERS = {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
           "Cross-Origin-Resource-Policy": "same-origin", "Cache-Control": "no-cache"}

_RANGE = re.compile(r"bytes=([0-9]{0,15})-([0-9]{0,15})")


@dataclass(frozen=True)
class Resource:
    """Something that is served: a file of the disk, or bytes.

    Args:
        content_type: its MIME type.
        path: the file; None: `data` is served.
        data: the bytes.

    >>> stream, size = Resource("text/html", data=b"page").opened()
    >>> stream.read(), size
    (b'page', 4)
    """

    content_type: str
    path: Path | None = None
    data: bytes = b""

    def opened(self) -> tuple[BinaryIO, int]:
        """A stream to read it from, and its size in bytes.

        Raises:
            OSError: the file cannot be read.
        """
        if self.path is None:
            return BytesIO(self.data), len(self.data)
        file = self.path.open("rb")
        return file, os.fstat(file.fileno()).st_size


class Server:
    """A running server, which `serve` and `view` make; a context manager that ends it.

    Attributes:
        url: of the page that shows the file.
        port: on which 127.0.0.1 is listened to.

    >>> import tempfile, urllib.request
    >>> from hmkcta import Model
    >>> from hmkcta._example import example_level, example_metadata
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Model(example_metadata(), [example_level()]).save(f"{folder}/small.hmk")
    ...     with serve(f"{folder}/small.hmk", page={"/": Resource("text/html", data=b"page")}) as server:
    ...         request = urllib.request.Request(server.url.split("?")[0] + "files/small.hmk",
    ...                                          headers={"Range": "bytes=8-8"})
    ...         urllib.request.urlopen(request).read()
    b'{'
    """

    def __init__(self, table: Mapping[str, Resource], query: str, port: int) -> None:
        self._server = _Listener(table, port)
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}/{query}"
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

    def wait(self) -> None:
        """Wait while it serves, until it is closed from another thread or Ctrl-C interrupts (`KeyboardInterrupt`)."""
        while self._thread.is_alive():
            self._thread.join(0.5)


def serve(path: str | os.PathLike[str], *, original: str | os.PathLike[str] | ArrayLike | None = None,
          nan: float | None = None, port: int = 0, page: Mapping[str, Resource] | None = None,
          progress: Progress | None = None) -> Server:
    """Serve the viewer and a file on 127.0.0.1.

    Args:
        path: the `.hmk` file. It is checked here as `hmkcta.open` does, and again by the page, which reads it anew
            at each reload.
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
    ...         server.url == f"http://127.0.0.1:{server.port}/?file=files/small.hmk"
    True
    """
    expect("path", path, str | os.PathLike, "the path of an .hmk file", "save the model first: model.save(path)")
    expect("port", port, Integral, "a whole number")
    file = Path(path)
    metadata = open_model(file).metadata
    table = dict(page if page is not None else installed_page())
    table[f"/files/{file.name}"] = Resource("application/octet-stream", file)
    # The page reads a parameter, and takes what it reads for an address: the name is quoted for both.
    address = "files/" + quote(os.fsencode(file.name), safe=" ")
    query = f"?file={quote(address)}"
    if original is not None:
        table["/original/original.hmk"] = _original(metadata, original, nan, progress)
        query += "&original=original/original.hmk"
    return Server(table, query, port)


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
        is_opened(server.url)
    return server


def is_opened(url: str) -> bool:
    """Open an address in the browser; whether one could be.

    >>> is_opened("http://127.0.0.1:8000/")  # doctest: +SKIP
    True
    """
    try:
        return webbrowser.open(url)
    except (webbrowser.Error, OSError):
        return False


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
            check_shape(open_model(original).shape, like)
            return Resource("application/octet-stream", Path(original))
        original = open_array(os.fspath(original), progress=progress)
    metadata, level = verbatim(original, like, nan)
    return Resource("application/octet-stream", data=b"".join(encode(metadata, (level,))))


class _Listener(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, table: Mapping[str, Resource], port: int) -> None:
        self.table = table
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise HmkctaError(Kind.IO, "port-taken", f"port {port}", found=getattr(error, "strerror", error),
                              allowed="a free port", hint="leave --port out to take any") from error

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed in the middle of a request is nobody's business either."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "hmkcta"
    sys_version = ""
    timeout = 60

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are nobody's business on the terminal."""

    def _answer(self, with_body: bool) -> None:
        listener = cast("_Listener", self.server)
        port = int(listener.server_address[1])
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST)
            return
        try:
            path = unquote(urlsplit(self.path).path, errors="surrogateescape")
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST)
            return
        resource = listener.table.get(path)
        if resource is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        try:
            stream, size = resource.opened()
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        with stream:
            self._send(resource, stream, size, with_body)

    def _send(self, resource: Resource, stream: BinaryIO, size: int, with_body: bool) -> None:
        span = _span(self.headers.get("Range"), size)
        if span is None:
            self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, {"Content-Range": f"bytes */{size}"})
            return
        begin, end = span
        partial = self.headers.get("Range") is not None and span != (0, size)
        self.send_response(HTTPStatus.PARTIAL_CONTENT if partial else HTTPStatus.OK)
        extra = {"Content-Range": f"bytes {begin}-{end - 1}/{size}"} if partial else {}
        for name, value in {**HEADERS, "Content-Type": resource.content_type, "Content-Length": str(end - begin),
                            "Accept-Ranges": "bytes", **extra}.items():
            self.send_header(name, value)
        self.end_headers()
        if not with_body:
            return
        stream.seek(begin)
        try:
            while begin < end and (chunk := stream.read(min(CHUNK, end - begin))):
                self.wfile.write(chunk)
                begin += len(chunk)
        except ConnectionError:  # the page was closed or reloaded
            self.close_connection = True
        if begin < end:  # the file became shorter meanwhile: the length that was announced cannot be kept
            self.close_connection = True

    def _refuse(self, status: HTTPStatus, extra: Mapping[str, str] = {}) -> None:
        body = f"{status.value} {status.phrase}\n".encode()
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": "text/plain", "Content-Length": str(len(body)), **extra}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def _span(header: str | None, size: int) -> tuple[int, int] | None:
    """Begin and end of the bytes that a `Range` header asks for; all of them without one, None if there are none such.

    What is not understood (several ranges, other units) is ignored, as HTTP has it.

    >>> [_span(text, 10) for text in ("bytes=2-5", "bytes=8-", "bytes=-3", "bytes=10-", "lines=1")]
    [(2, 6), (8, 10), (7, 10), None, (0, 10)]
    """
    found = _RANGE.fullmatch(header.strip()) if header is not None else None
    if found is None or found.groups() == ("", ""):
        return 0, size
    first, last = found.groups()
    if not first:
        return (max(0, size - int(last)), size) if int(last) and size else None
    begin, end = int(first), min(size, int(last) + 1) if last else size
    if begin >= size:
        return None
    return (begin, end) if begin < end else (0, size)
