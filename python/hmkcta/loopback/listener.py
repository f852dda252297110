"""HTTP on 127.0.0.1: a table of answers, some of them only for clients that have the token.

Every client may be hostile: another user of this computer, or a page of another site in the user's own browser. Only
the names of the table are answered, so that no path is ever looked up; only requests that name this host, so that a
page whose name server points here reads nothing. Requests, their time and their number are bounded, and who has shown
the token comes before who has not.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from hmac import compare_digest
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedReader, RawIOBase
from time import monotonic
from typing import Any, cast
from urllib.parse import parse_qs, unquote

from ..errors import HmkctaError, Kind
from .resource import Resource, span_of

HOST = "127.0.0.1"
CHUNK = 1 << 20

#: Connections at a time; beyond them the oldest without the token makes room.
CONNECTIONS = 64
#: Requests that one connection may make, one after the other.
REQUESTS = 1000
#: Bytes of a request, which has no body, and seconds to wait for all of them.
HEAD_BYTES, HEAD_SECONDS = 1 << 14, 15.0
#: Seconds without a part of the answer having been taken; for the whole answer; and bytes that add a second to these.
STALL_SECONDS, ANSWER_SECONDS, BYTES_A_SECOND = 30.0, 60.0, 1 << 18

#: The page decodes on the GPU, draws what it makes itself, and talks to nobody.
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
          "base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
HEADERS = {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
           "Cross-Origin-Resource-Policy": "same-origin", "Cache-Control": "no-store"}


class Listener(ThreadingHTTPServer):
    """A server on a port of 127.0.0.1.

    Args:
        public: answers for everybody, by path.
        secret: answers for clients with the token, by path.
        token: what these have in the query (`token=..`) or in a header (`Authorization: Bearer ..`).
        port: 0 takes a free one.

    Raises:
        HmkctaError: reason ``port-taken``.
    """

    daemon_threads = True
    request_queue_size = CONNECTIONS
    # On Windows the option lets another program listen to the same port.
    allow_reuse_address = os.name == "posix"

    def __init__(self, public: Mapping[str, Resource], secret: Mapping[str, Resource], token: str, port: int) -> None:
        self.public, self.secret, self._token = dict(public), dict(secret), token.encode()
        self._lock = threading.Lock()
        self._clients: dict[socket.socket, bool] = {}  # whether each has shown the token; the oldest comes first
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise HmkctaError(Kind.IO, "port-taken", f"port {port}", found=getattr(error, "strerror", error),
                              allowed="a free port", hint="leave --port out to take any") from error

    def knows(self, tokens: list[str], client: socket.socket) -> bool:
        """Whether one of these is the token, in a time that says nothing of it; the client is trusted from then on."""
        found = [compare_digest(self._token, token.encode(errors="surrogateescape")) for token in tokens]
        if not any(found):
            return False
        with self._lock:
            if client in self._clients:
                self._clients[client] = True
        return True

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread of its own, if there is room."""
        with self._lock:
            if len(self._clients) >= CONNECTIONS:
                stranger = next((client for client, trusted in self._clients.items() if not trusted), None)
                if stranger is not None:
                    self._end(stranger)
            room = len(self._clients) < CONNECTIONS
            if room:
                self._clients[request] = False
        if room:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Forget a connection that is over."""
        with self._lock:
            self._clients.pop(request, None)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Free the port, and end the connections that there are."""
        super().server_close()
        with self._lock:
            for client in list(self._clients):
                self._end(client)
        for resource in self.secret.values():
            resource.close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed in the middle of a request is nobody's business either."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    def _end(self, client: socket.socket) -> None:
        """Wake the thread of a connection, which closes it."""
        del self._clients[client]
        with suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)


class _HeadTooLarge(Exception):
    """A request of more bytes than are read."""


class _Inlet(RawIOBase):
    """What a client sends, a request at a time: as many bytes as one may have, within its time."""

    def __init__(self, client: socket.socket) -> None:
        self._client = client
        self.begin()

    def begin(self) -> None:
        """From here on the next request is read."""
        self._until, self._room, self.cut = monotonic() + HEAD_SECONDS, HEAD_BYTES, False

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self._until - monotonic()
        if left <= 0:
            raise TimeoutError
        if self._room <= 0:
            raise _HeadTooLarge
        self._client.settimeout(left)
        count = self._client.recv_into(buffer, min(len(buffer), self._room))
        self._room -= count
        self.cut = count == 0
        return count


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "hmkcta"
    sys_version = ""
    command = ""

    def setup(self) -> None:
        super().setup()
        self._inlet = _Inlet(self.connection)
        self.rfile = BufferedReader(self._inlet)
        self._requests = 0

    def handle_one_request(self) -> None:
        self._inlet.begin()
        self.command, self.requestline, self.request_version = "", "", self.protocol_version
        self._requests += 1
        try:
            super().handle_one_request()
        except _HeadTooLarge:
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        if self._requests >= REQUESTS:
            self.close_connection = True

    def parse_request(self) -> bool:
        """Whether the request is a whole one that any HTTP client would send, and has no body: what may be read in two
        ways is not read."""
        if not super().parse_request():
            return False
        if self.request_version == "HTTP/0.9":
            self.send_error(HTTPStatus.HTTP_VERSION_NOT_SUPPORTED)
            return False
        body = self.headers.get_all("Content-Length", []) not in ([], ["0"]) or "Transfer-Encoding" in self.headers
        if self._inlet.cut or self.headers.defects or body or not self.path.startswith("/"):
            self.send_error(HTTPStatus.BAD_REQUEST)
            return False
        return True

    def handle_expect_100(self) -> bool:
        """A request without a body has nothing to wait for."""
        self.send_error(HTTPStatus.EXPECTATION_FAILED)
        return False

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are nobody's business on the terminal."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse in a line of text, and close the connection: what follows may be meant as anything."""
        del message, explain
        self.request_version = self.protocol_version  # before it is known a status line would be left out
        self._refuse(HTTPStatus(code))

    def _answer(self) -> None:
        listener = cast("Listener", self.server)
        port = int(listener.server_address[1])
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].lower() not in (f"{HOST}:{port}", f"localhost:{port}"):
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST)
            return
        asked, _, query = self.path.partition("?")
        path = unquote(asked, errors="surrogateescape")
        resource = listener.public.get(path)
        if resource is None:
            if not listener.knows(self._tokens(query), self.connection):  # nor whether there is such a name
                self._refuse(HTTPStatus.FORBIDDEN)
                return
            resource = listener.secret.get(path)
        try:
            if resource is None:
                raise FileNotFoundError
            size = resource.size()
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self._send(resource, size)

    def _tokens(self, query: str) -> list[str]:
        try:
            given = parse_qs(query, max_num_fields=16).get("token", [])
        except ValueError:
            given = []
        scheme, _, credentials = self.headers.get("Authorization", "").partition(" ")
        return [*given, credentials.strip()] if scheme.lower() == "bearer" else given

    def _send(self, resource: Resource, size: int) -> None:
        ranges = self.headers.get_all("Range", [])
        # Ranges are of GET alone, and of what they are asked for: without a validator that is not known.
        usable = self.command == "GET" and len(ranges) == 1 and "If-Range" not in self.headers
        partial, span = span_of(ranges[0] if usable else None, size)
        if span is None:
            self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, {"Content-Range": f"bytes */{size}"})
            return
        begin, end = span
        extra = {"Content-Range": f"bytes {begin}-{end - 1}/{size}"} if partial else {}
        self._head(HTTPStatus.PARTIAL_CONTENT if partial else HTTPStatus.OK,
                   {"Content-Type": resource.content_type, "Content-Length": str(end - begin),
                    "Accept-Ranges": "bytes", **extra})
        if self.command == "HEAD":
            return
        until = monotonic() + ANSWER_SECONDS + (end - begin) / BYTES_A_SECOND
        try:
            while begin < end and (chunk := resource.read(begin, min(CHUNK, end - begin))):
                self._give(chunk, until)
                begin += len(chunk)
        except OSError:  # the page was closed or reloaded, takes too long, or the file cannot be read
            self.close_connection = True
        if begin < end:  # the length that was announced cannot be kept: the file may have become shorter meanwhile
            self.close_connection = True

    def _give(self, chunk: bytes, until: float) -> None:
        left = min(STALL_SECONDS, until - monotonic())
        if left <= 0:
            raise TimeoutError
        self.connection.settimeout(left)  # for all of the chunk
        self.wfile.write(chunk)

    def _head(self, status: HTTPStatus, headers: Mapping[str, str]) -> None:
        self.connection.settimeout(STALL_SECONDS)
        self.send_response(status)
        for name, value in {**HEADERS, **headers}.items():
            self.send_header(name, value)
        self.end_headers()

    def _refuse(self, status: HTTPStatus, extra: Mapping[str, str] = {}) -> None:
        body = f"{status.value} {status.phrase}\n".encode()
        self._head(status, {"Content-Type": "text/plain", "Content-Length": str(len(body)), "Connection": "close",
                            **extra})
        if self.command != "HEAD":
            self.wfile.write(body)
