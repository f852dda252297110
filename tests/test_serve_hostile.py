"""`hmkcta view`'s server against whoever finds its port: no token, no file; no client in the way of another."""

from __future__ import annotations

import os
import re
import socket
import stat
import subprocess
import sys
import time
import webbrowser
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from cli_tools import finish, start
from hmkcta import Model, compress
from hmkcta.errors import HmkctaError
from hmkcta.loopback import listener
from hmkcta.serve import Resource, Server, serve

PAGE = {"/": Resource("text/html; charset=utf-8", data=b"<!doctype html>page")}


@pytest.fixture(scope="module")
def model() -> Model:
    return compress(np.random.default_rng(1).normal(size=(5, 6, 7)).astype(np.float32), "R=3,3,3")


@pytest.fixture
def file(model: Model, tmp_path: Path) -> Path:
    model.save(tmp_path / "a.hmk")
    return tmp_path / "a.hmk"


@pytest.fixture
def server(file: Path) -> Generator[Server]:
    with serve(file, page=PAGE) as running:
        yield running


def connected(server: Server) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), timeout=20)


def received(client: socket.socket) -> bytes:
    """What comes until the other side ends it, however it does."""
    parts = list[bytes]()
    with suppress(ConnectionError):
        while part := client.recv(1 << 16):
            parts.append(part)
    return b"".join(parts)


def said(server: Server, text: bytes | str) -> bytes:
    """The answer to bytes, after which nothing is sent."""
    with connected(server) as client:
        client.sendall(text.encode() if isinstance(text, str) else text)
        client.shutdown(socket.SHUT_WR)
        return received(client)


def get(server: Server, path: str = "/files/a.hmk", *headers: str, method: str = "GET", token: bool = True) -> bytes:
    """The answer to a request with the token."""
    lines = [f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{server.port}", "Connection: close", *headers]
    lines += [f"Authorization: Bearer {server.token}"] if token else []
    return said(server, "\r\n".join([*lines, "", ""]))


def status(answer: bytes) -> int:
    found = re.match(rb"HTTP/1\.1 (\d{3}) ", answer)
    assert found is not None, answer[:200]
    return int(found[1])


def body(answer: bytes) -> bytes:
    return answer.partition(b"\r\n\r\n")[2]


def test_the_file_is_only_for_who_has_the_token(server: Server, file: Path) -> None:
    whole, token = file.read_bytes(), server.token
    assert len(token) >= 22  # 128 bits and more
    assert body(get(server)) == whole
    assert body(get(server, f"/files/a.hmk?token={token}", token=False)) == whole
    with urlopen(f"http://127.0.0.1:{server.port}/files/a.hmk?token={token}", timeout=20) as answer:
        assert answer.read() == whole
    wrong = ("", f"?token={token[:-1]}", f"?token={token}x", "?token=", "?token=é", f"?Token={token}",
             f"?{'a=1&' * 20}token={token}", "?token=%ff%00")
    headers = (f"Authorization: Basic {token}", f"Authorization: {token}", "Authorization: Bearer ",
               f"Cookie: t={token}", "Authorization: Bearer \xff")
    refusals = [get(server, f"/files/a.hmk{query}", token=False) for query in wrong]
    refusals += [get(server, "/files/a.hmk", header, token=False) for header in headers]
    assert {status(answer) for answer in refusals} == {403}
    assert all(len(body(answer)) < 100 for answer in refusals)


def test_names_are_not_told_either(server: Server) -> None:
    without = [get(server, path, token=False) for path in ("/files/a.hmk", "/files/b.hmk", "/original/original.hmk")]
    assert {status(answer) for answer in without} == {403}
    assert {body(answer) for answer in without} == {b"403 Forbidden\n"}
    assert status(get(server, "/files/b.hmk")) == 404
    assert status(get(server, "/", token=False)) == 200


def test_each_server_has_a_token_of_its_own(server: Server, file: Path) -> None:
    with serve(file, page=PAGE) as other:
        assert other.token != server.token
        assert status(get(other, f"/files/a.hmk?token={server.token}", token=False)) == 403


def test_the_browsers_command_line_does_not_have_the_token(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everybody on the computer sees the arguments of a process."""
    opened = list[str]()

    def noted(url: str) -> bool:
        opened.append(url)
        return True

    monkeypatch.setattr(webbrowser, "open", noted)
    assert server.open_browser()
    assert server.token not in opened[0]
    door = Path(unquote(urlsplit(opened[0]).path))
    assert server.url.replace("&", "&amp;") in door.read_text(encoding="utf-8")
    assert stat.S_IMODE(door.parent.stat().st_mode) == 0o700
    server.close()
    assert not door.parent.exists()


def test_it_serves_the_file_that_was_opened(file: Path, tmp_path: Path) -> None:
    """Whatever its name leads to later."""
    whole, secret, link = file.read_bytes(), tmp_path / "secret.txt", tmp_path / "link.hmk"
    secret.write_text("secret")
    link.symlink_to(file)
    with serve(link, original=link, page=PAGE) as running:
        link.unlink()
        link.symlink_to(secret)
        assert body(get(running, "/files/link.hmk")) == whole
        assert body(get(running, "/original/original.hmk")) == whole
        link.unlink()
        assert body(get(running, "/files/link.hmk")) == whole
        file.write_bytes(b"other")  # in place, which the page will say
        assert body(get(running, "/files/link.hmk")) == b"other"


def test_what_is_checked_is_what_is_served(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a name is given to another file between one look at it and the next."""
    secret, link, whole = tmp_path / "secret.txt", tmp_path / "link.hmk", file.read_bytes()
    secret.write_text("secret")
    link.symlink_to(file)
    before = os.fstat

    def swapped(descriptor: int) -> os.stat_result:
        link.unlink(missing_ok=True)
        link.symlink_to(secret)
        return before(descriptor)

    monkeypatch.setattr(os, "fstat", swapped)
    with serve(link, page=PAGE) as running:
        assert body(get(running, "/files/link.hmk")) == whole


@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "socket"])
def test_no_regular_file_is_refused(file: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / "odd.hmk"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(str(path))
    for shown, original in ((path, None), (file, path)):
        with pytest.raises(HmkctaError, match="is no regular file") as caught:
            serve(shown, original=original, page=PAGE)
        assert caught.value.reason == "unreadable"


def test_a_pipe_that_takes_the_name_at_the_last_moment_is_refused(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe, found = tmp_path / "pipe", file.stat()
    os.mkfifo(pipe)

    def former(path: object) -> os.stat_result:
        del path
        return found

    monkeypatch.setattr("hmkcta.hmkfile.read.os.stat", former)
    with pytest.raises(HmkctaError, match="is no regular file"):
        serve(pipe, page=PAGE)


def test_a_server_that_is_closed_lets_go_of_its_file(file: Path) -> None:
    running = serve(file, page=PAGE)
    with connected(running) as client:
        lines = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{running.port}\r\n\r\n".encode()
        client.sendall(lines)
        found = b""
        while not found.endswith(b"page"):
            found += client.recv(1 << 16)
        running.close()
        assert received(client) == b""
    held = [os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd") if name.isdigit()
            and os.path.lexists(f"/proc/self/fd/{name}")] if Path("/proc/self/fd").exists() else []
    assert str(file) not in held


HOST = "Host: 127.0.0.1:{port}"


@pytest.mark.parametrize(("request_", "codes"), [
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nContent-Length: 30\r\n\r\nGET / HTTP/1.1\r\n{host}\r\n\r\n",
     [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nContent-Length: 0\r\nContent-Length: 5\r\n\r\n", [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\nHost: evil.example\r\n{token}\r\n\r\n", [421]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{host}\r\n{token}\r\n\r\n", [421]),
    ("GET /files/a.hmk HTTP/1.1\r\n{token}\r\n\r\n", [421]),
    ("GET http://evil.example/files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\n\r\n", [400]),
    ("GET files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\n\r\n", [400]),
    ("GET * HTTP/1.1\r\n{host}\r\n{token}\r\n\r\n", [400]),
    ("GET /files/a.hmk\r\n{host}\r\n{token}\r\n\r\n", [505]),
    ("GET /files/a.hmk HTTP/2.0\r\n{host}\r\n{token}\r\n\r\n", [505]),
    ("GET /files/a.hmk HTTP/1.x\r\n{host}\r\n{token}\r\n\r\n", [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nno colon\r\n\r\n", [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nExpect: 100-continue\r\n\r\n", [417]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}", [400]),
    ("GET /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\n", [400]),
    ("get /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\n\r\n", [501]),
    ("POST /files/a.hmk HTTP/1.1\r\n{host}\r\n{token}\r\nContent-Length: 3\r\n\r\nabc", [400]),
    ("CONNECT 127.0.0.1:80 HTTP/1.1\r\n{host}\r\n\r\n", [400]),
    ("GET /" + 9000 * "a" + " HTTP/1.1\r\n{host}\r\n{token}\r\n\r\n", [404]),
    ("GET /" + 60000 * "a" + " HTTP/1.1\r\n{host}\r\n\r\n", [431]),
    ("GET / HTTP/1.1\r\n{host}\r\n" + "A: " + 60000 * "a" + "\r\n\r\n", [431]),
    ("GET / HTTP/1.1\r\n{host}\r\n" + 200 * "A: b\r\n" + "\r\n", [431]),
    ("HEAD / HTTP/1.1\r\n{host}\r\n\r\nHEAD / HTTP/1.1\r\n{host}\r\n\r\n", [200, 200]),
    ("HEAD / HTTP/1.1\r\n{host}\r\n\r\nHEAD /no HTTP/1.1\r\n{host}\r\n\r\nHEAD / HTTP/1.1\r\n{host}\r\n\r\n",
     [200, 403]),
    ("\r\nHEAD / HTTP/1.1\r\n{host}\r\n\r\n", []),
    ("\0\xff\r\n\r\n", [400]),
])
def test_what_can_be_read_in_two_ways_is_not_read(server: Server, request_: str, codes: list[int]) -> None:
    """Nothing of the file, and after a refusal no further request of the connection is answered."""
    text = request_.format(host=HOST.format(port=server.port), token=f"Authorization: Bearer {server.token}")
    with connected(server) as client:
        with suppress(OSError):  # it has already hung up
            client.sendall(text.encode("latin-1"))
            client.shutdown(socket.SHUT_WR)
        answer = received(client)
    found = [int(code) for code in re.findall(rb"HTTP/1\.1 (\d{3}) ", answer)]
    # Where more is sent than is read, the system may drop the answer.
    assert found == codes or (codes == [431] and not found)
    assert b'"shape"' not in answer
    assert status(get(server)) == 200


def test_ranges_are_of_get_and_of_what_is_known(server: Server, file: Path) -> None:
    whole = file.read_bytes()
    size = len(whole)
    for asked, begin, end in (("bytes=0-", 0, size), ("Bytes=5-7", 5, 8), (f"bytes=0-{size - 1}", 0, size),
                              (f"bytes={size - 1}-{10**30}", size - 1, size), (f"bytes=-{10**30}", 0, size)):
        answer = get(server, "/files/a.hmk", f"Range: {asked}")
        assert status(answer) == 206
        assert body(answer) == whole[begin:end]
        assert f"Content-Range: bytes {begin}-{end - 1}/{size}\r\n".encode() in answer
    for asked in (f"bytes={size}-", f"bytes={10**30}-", "bytes=-0"):
        assert status(get(server, "/files/a.hmk", f"Range: {asked}")) == 416
    for headers in (("Range: bytes=0-1", "Range: bytes=2-3"), ("Range: bytes=0-1", 'If-Range: "x"'),
                    ("Range: bytes=0-1,3-4",), ("Range: bytes=9-3",)):
        answer = get(server, "/files/a.hmk", *headers)
        assert (status(answer), body(answer)) == (200, whole)
    answer = get(server, "/files/a.hmk", "Range: bytes=0-1", method="HEAD")
    assert (status(answer), body(answer)) == (200, b"")
    assert f"Content-Length: {size}\r\n".encode() in answer


def test_a_request_that_does_not_end_is_ended(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """A byte at a time, none at all, or a second request that does not come: the time is for all of it."""
    monkeypatch.setattr(listener, "HEAD_SECONDS", 0.5)
    for text in (b"GET / HT", b"GET / HTTP/1.1\r\nA: b\r\n", b""):
        with connected(server) as client:
            client.sendall(text)
            client.settimeout(0.05)
            begun = time.monotonic()
            while time.monotonic() < begun + 10:
                try:
                    if not client.recv(100):
                        break
                except TimeoutError:
                    if text:
                        client.sendall(b"a")
                except ConnectionError:
                    break
            assert time.monotonic() < begun + 5


def test_an_answer_that_is_not_taken_is_given_up(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "STALL_SECONDS", 0.3)
    with serve(file, page={"/": Resource("text/html", data=bytes(1 << 25))}) as running, connected(running) as client:
        client.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{running.port}\r\n\r\n".encode())
        time.sleep(1)
        assert len(received(client)) < 1 << 25


def test_an_answer_has_its_time(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though each part of it is taken."""
    monkeypatch.setattr(listener, "ANSWER_SECONDS", 0.3)
    monkeypatch.setattr(listener, "BYTES_A_SECOND", 1 << 40)
    monkeypatch.setattr(listener, "CHUNK", 1 << 16)
    with serve(file, page={"/": Resource("text/html", data=bytes(1 << 25))}) as running, connected(running) as client:
        client.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{running.port}\r\n\r\n".encode())
        taken, begun = 0, time.monotonic()
        while (part := client.recv(1 << 16)) and time.monotonic() < begun + 10:
            taken += len(part)
            time.sleep(0.01)
        assert taken < 1 << 25
        assert time.monotonic() < begun + 8


def test_many_clients_do_not_lock_out_the_page(server: Server, file: Path) -> None:
    """Those without the token make room, and their threads end."""
    idle = [connected(server) for _ in range(listener.CONNECTIONS + 40)]
    try:
        assert body(get(server)) == file.read_bytes()
        ended = 0
        for client in idle:
            client.settimeout(0.01)
            try:
                ended += not client.recv(1)
            except TimeoutError:
                pass
            except ConnectionError:
                ended += 1
        assert ended >= 40
    finally:
        for client in idle:
            client.close()


def test_who_has_the_token_keeps_the_connection(server: Server) -> None:
    request = f"HEAD /files/a.hmk?token={server.token} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode()
    with connected(server) as client:
        client.sendall(request)
        assert status(client.recv(4096)) == 200
        idle = [connected(server) for _ in range(listener.CONNECTIONS + 10)]
        time.sleep(0.2)
        client.sendall(request)
        assert status(client.recv(4096)) == 200
        for other in idle:
            other.close()


def test_requests_of_a_connection_are_counted(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "REQUESTS", 3)
    answer = said(server, 5 * f"HEAD / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n")
    assert answer.count(b"HTTP/1.1 200") == 3


def test_a_hostile_client_says_nothing_on_the_terminal(file: Path) -> None:
    before = "import hmkcta.serve as s; s.installed_page = lambda: {'/': s.Resource('text/html', data=b'page')}"
    process = start("view", file, "--no-browser", before=before)
    assert process.stdout is not None
    url = urlsplit(str(process.stdout.readline()).strip())
    assert url.port is not None
    assert "token=" in url.query
    for text in (b"\0\xff\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"A" * 100_000, b""):
        with socket.create_connection(("127.0.0.1", url.port), timeout=20) as client, suppress(ConnectionError):
            client.sendall(text)
    time.sleep(0.3)
    process.send_signal(2)
    assert finish(process)[::2] == (0, "")


def test_the_port_is_let_go_of(file: Path) -> None:
    """Also by a program that ends in the middle of requests."""
    program = (f"from hmkcta.serve import Resource, serve\nimport socket\n"
               f"s = serve({str(file)!r}, page={{'/': Resource('text/html', data=b'x')}})\n"
               f"c = socket.create_connection(('127.0.0.1', s.port))\ns.close()\n")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60,
                          env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent / "python")})
    assert (done.returncode, done.stderr) == (0, "")
