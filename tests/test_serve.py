"""`hmkcta view`'s server: what it gives, to whom, and nothing else; and originals as models."""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

import numpy as np
import pytest

from cli_tools import PYTHON, finish, saved, start
from hmkcta import Model, compress
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import encode, loads
from hmkcta.loopback import POLICY
from hmkcta.serve import Resource, Server, installed_page, serve
from hmkcta.verbatim import verbatim

PAGE = {"/": Resource("text/html; charset=utf-8", data=b"<!doctype html>page")}


@pytest.fixture(scope="module")
def model() -> Model:
    values = np.random.default_rng(1).normal(size=(5, 6, 7)).astype(np.float32)
    return compress(values, "R=3,3,3", axes=["a", "y", "x"])


@pytest.fixture
def file(model: Model, tmp_path: Path) -> Path:
    path = tmp_path / "a file.hmk"
    model.save(path)
    (tmp_path / "secret.txt").write_text("secret")
    return path


@pytest.fixture
def server(file: Path) -> Generator[Server]:
    with serve(file, page=PAGE) as running:
        yield running


def ask(server: Server, path: str, method: str = "GET", **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request(method, path, headers={"Authorization": f"Bearer {server.token}", **headers})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_page_and_file(server: Server, file: Path) -> None:
    answer, body = ask(server, "/")
    assert (answer.status, body) == (200, b"<!doctype html>page")
    assert answer.headers["Content-Security-Policy"] == POLICY
    assert "unsafe" not in POLICY
    assert "*" not in POLICY
    answer, body = ask(server, "/files/a%20file.hmk")
    assert (answer.status, body) == (200, file.read_bytes())
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert server.url == f"http://127.0.0.1:{server.port}/?token={server.token}&file=files/a%20file.hmk"


@pytest.mark.parametrize("name", ["run#3.hmk", "a?b.hmk", "a%20b.hmk", "50%.hmk", "é.hmk"])
def test_any_name_is_served(name: str, model: Model, tmp_path: Path) -> None:
    """The page reads a parameter of its address, and takes what it reads for an address."""
    model.save(tmp_path / name)
    with serve(tmp_path / name, page=PAGE) as running:
        address = parse_qs(urlsplit(running.url).query)["file"][0]
        assert "#" not in address
        assert "?" not in address
        answer, body = ask(running, "/" + quote(address, safe="/%"))
    assert (answer.status, body) == (200, (tmp_path / name).read_bytes())


@pytest.mark.parametrize(("asked", "begin", "end"), [("bytes=0-99", 0, 100), ("bytes=100-", 100, None),
                                                     ("bytes=-16", -16, None), ("bytes=8-99999999", 8, None)])
def test_byte_ranges(server: Server, file: Path, asked: str, begin: int, end: int | None) -> None:
    whole = file.read_bytes()
    answer, body = ask(server, "/files/a%20file.hmk", Range=asked)
    assert (answer.status, body) == (206, whole[begin:end])
    first = begin % len(whole)
    assert answer.headers["Content-Range"] == f"bytes {first}-{first + len(body) - 1}/{len(whole)}"


def test_ranges_outside_and_odd_ones(server: Server, file: Path) -> None:
    size = file.stat().st_size
    answer, _ = ask(server, "/files/a%20file.hmk", Range=f"bytes={size}-")
    assert (answer.status, answer.headers["Content-Range"]) == (416, f"bytes */{size}")
    for odd in ("bytes=9-3", "bytes=0-1,3-4", "lines=0-1", "bytes=-", "bytes=a-b"):
        answer, body = ask(server, "/files/a%20file.hmk", Range=odd)
        assert (answer.status, len(body)) == (200, size), odd


def test_it_is_loaded_when_it_is_first_used() -> None:
    program = "import sys, hmkcta; before = 'hmkcta.serve' in sys.modules; hmkcta.serve.view; print(before)"
    environment = {**os.environ, "PYTHONPATH": str(PYTHON)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60,
                          env=environment)
    assert done.stdout == "False\n"


def test_head(server: Server, file: Path) -> None:
    answer, body = ask(server, "/files/a%20file.hmk", "HEAD")
    assert (answer.status, int(answer.headers["Content-Length"]), body) == (200, file.stat().st_size, b"")


@pytest.mark.parametrize("path", ["/files/", "/files", "/files/secret.txt", "/files/../files/secret.txt", "/index",
                                  "/..%2fsecret.txt", "//etc/passwd", "/files/%2e%2e/secret.txt", "/etc/passwd",
                                  "/\\secret.txt"])
def test_nothing_else_is_served(server: Server, path: str) -> None:
    answer, body = ask(server, path)
    assert answer.status == 404
    assert b"secret" not in body.replace(path.encode(), b"")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"])
def test_other_methods_are_refused(server: Server, method: str) -> None:
    answer, _ = ask(server, "/", method)
    assert answer.status == 501


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1", "127.0.0.1:1", "localhost.evil:80",
                                  ""])
def test_other_host_names_are_refused(server: Server, host: str) -> None:
    """A name server that points a foreign name at this machine gets its page nothing."""
    answer, body = ask(server, "/files/a%20file.hmk", Host=host)
    assert answer.status == 421
    assert len(body) < 100


def test_localhost_is_this_host(server: Server) -> None:
    assert ask(server, "/", Host=f"localhost:{server.port}")[0].status == 200


def test_only_loopback_listens(server: Server) -> None:
    listening = Path("/proc/net/tcp")
    if not listening.exists():
        pytest.skip("no /proc/net/tcp on this system")
    port = f":{server.port:04X}"
    addresses = {line.split()[1] for line in listening.read_text().splitlines()[1:] if line.split()[3] == "0A"}
    assert {address for address in addresses if address.endswith(port)} == {f"0100007F{port}"}


def test_a_broken_request_does_not_end_it(server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as raw:
        raw.sendall(b"\0\xff nonsense\r\n\r\n")
        raw.recv(100)
    assert ask(server, "/")[0].status == 200


def test_a_port_that_is_taken(server: Server, file: Path) -> None:
    with pytest.raises(HmkctaError) as caught:
        serve(file, page=PAGE, port=server.port)
    assert caught.value.reason == "port-taken"


def test_an_original_is_a_model_that_decodes_to_itself(model: Model, file: Path) -> None:
    values = model[...].astype(np.float32) * 1e6
    metadata, level = verbatim(values, model.metadata)
    again = Model(*loads(b"".join(encode(metadata, (level,)))))
    np.testing.assert_allclose(again[...], values, atol=float(abs(values).max()) * 2.0**-11)
    assert again.snr > 60
    saved(file.parent / "source.npy", values)
    with serve(file, original=file.parent / "source.npy", page=PAGE) as running:
        assert running.url.endswith("&original=original/original.hmk")
        assert ask(running, "/original/original.hmk")[1] == b"".join(encode(metadata, (level,)))


def test_originals_that_are_unpacked_say_how_far_they_are(model: Model, file: Path) -> None:
    source, told = file.parent / "source.npz", list[tuple[str, float]]()
    np.savez_compressed(source, model[...])

    def note(stage: str, fraction: float) -> None:
        told.append((stage, fraction))

    with serve(file, original=source, page=PAGE, progress=note):
        assert told[-1] == ("unpacking", 1.0)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve(file, original=source, page=PAGE, progress=interrupted)


def test_originals_of_zeros_and_tiny_numbers(model: Model) -> None:
    for scale in (0.0, 1e-30, 1e30):
        values = np.full(model.shape, scale, np.float32)
        metadata, level = verbatim(values, model.metadata)
        np.testing.assert_allclose(Model(metadata, (level,))[...], values, rtol=1e-3)


def test_originals_that_do_not_fit(file: Path) -> None:
    for values, reason in ((np.zeros((5, 6, 8)), "original-shape"), (np.full((5, 6, 7), np.nan), "not-finite")):
        with pytest.raises(HmkctaError) as caught:
            serve(file, original=values, page=PAGE)
        assert caught.value.reason == reason


def test_a_value_stands_for_what_is_no_number_in_an_original(file: Path) -> None:
    values = np.where(np.arange(210).reshape(5, 6, 7) % 9 == 0, np.nan, 1.0)
    with serve(file, original=values, nan=0.5, page=PAGE) as running:
        served = Model(*loads(ask(running, "/original/original.hmk")[1]))
    assert np.array_equal(served[...], np.where(np.isnan(values), 0.5, 1.0))


def damaged(whole: bytes) -> dict[str, bytes]:
    """What a user may take for a file: cut short, damaged, of another kind, nothing at all."""
    flipped = bytearray(whole)
    flipped[-5] ^= 16
    return {"short": whole[:-3], "damaged": bytes(flipped), "picture": b"\x89PNG\r\n\x1a\n" + bytes(40), "empty": b""}


def test_it_refuses_what_info_refuses(file: Path, tmp_path: Path) -> None:
    """The same sentence and exit code, before anything is served."""
    paths = [tmp_path / "none.hmk", tmp_path]
    for name, content in damaged(file.read_bytes()).items():
        paths.append(tmp_path / f"{name}.hmk")
        paths[-1].write_bytes(content)
    for path in paths:
        seen = [finish(start(*command)) for command in (("info", path), ("view", path, "--no-browser"))]
        assert seen[0] == seen[1]
        assert seen[0][0] in range(3, 7)
        assert seen[0][2].startswith("hmkcta: ")


def test_other_files_as_originals(model: Model, file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.hmk"
    model.at_level(1).save(other)
    with serve(file, original=other, page=PAGE) as running:
        assert ask(running, "/original/original.hmk")[1] == other.read_bytes()
    compress(np.ones((5, 6, 7), np.float32), "R=1", axes=["time", "lat", "lon"]).save(other, overwrite=True)
    with serve(file, original=other, page=PAGE) as running:
        assert ask(running, "/original/original.hmk")[1] == other.read_bytes()
    compress(np.ones((5, 6), np.float32), "R=1,1", axes=["a", "y"]).save(other, overwrite=True)
    with pytest.raises(HmkctaError, match=r"found \(5, 6\), allowed \(5, 6, 7\), the model's. Next: give the array"):
        serve(file, original=other, page=PAGE)
    other.write_bytes(b"nothing")
    with pytest.raises(HmkctaError, match="foreign-file"):
        serve(file, original=other, page=PAGE)
    other.write_bytes(file.read_bytes()[:100])
    with pytest.raises(HmkctaError, match="truncated"):
        serve(file, original=other, page=PAGE)


@pytest.mark.parametrize("name", ["LF.HMK", "model", "model.npy"])
def test_other_files_as_originals_have_any_name(name: str, model: Model, file: Path) -> None:
    other = file.parent / name
    other.write_bytes(file.read_bytes())
    with serve(file, original=other, page=PAGE) as running:
        assert ask(running, "/original/original.hmk")[1] == file.read_bytes()
    before = "import hmkcta.serve as s; s.installed_page = lambda: {'/': s.Resource('text/html', data=b'page')}"
    process = start("view", file, "--original", other, "--no-browser", before=before)
    assert process.stdout is not None
    assert "&original=original/original.hmk" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    assert finish(process)[0] == 0
    array = saved(file.parent / "array.npy", model[...]).rename(file.parent / "array.hmk")
    with pytest.raises(HmkctaError, match="found what begins like a NumPy array"):
        serve(file, original=array, page=PAGE)


def test_originals_are_what_numpy_makes_an_array_of(model: Model, file: Path) -> None:
    values = model[...].astype(np.float16)
    with serve(file, original=values.tolist(), page=PAGE) as running:
        np.testing.assert_allclose(Model(*loads(ask(running, "/original/original.hmk")[1]))[...], values, rtol=1e-3)


@pytest.mark.parametrize(("original", "sentence"), [
    ([[1, 2]], r"original: found \(1, 2\), allowed \(5, 6, 7\), the model's\."),
    ([[1, 2], [3]], r"original: found \[\[1, 2\], \[3\]\], allowed as many numbers in each of its lists"),
    ({"a": 1}, "original: found dtype object, allowed floating point, integers or booleans"),
    (b"source.npy", "original: found dtype .S10, allowed floating point"),
    (np.ma.masked_less(np.zeros((5, 6, 7)), 1), "original: found 210 masked values, allowed no mask"),
], ids=["shape", "ragged", "mapping", "bytes", "masked"])
def test_originals_that_are_no_arrays_are_named(file: Path, original: Any, sentence: str) -> None:
    with pytest.raises(HmkctaError, match=sentence):
        serve(file, original=original, page=PAGE)


def test_a_clone_without_a_page_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hmkcta.serve.PAGE", "no_such_folder")
    with pytest.raises(HmkctaError) as caught:
        installed_page()
    assert caught.value.reason == "page-missing"
    assert "make page" in str(caught.value)


def test_ctrl_c_ends_it_cleanly(file: Path) -> None:
    before = "import hmkcta.serve as s; s.installed_page = lambda: {'/': s.Resource('text/html', data=b'page')}"
    process = start("view", file, "--no-browser", before=before)
    assert process.stdout is not None
    url = process.stdout.readline().strip()
    port = int(url.split(":")[2].split("/")[0])
    socket.create_connection(("127.0.0.1", port), timeout=10).close()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    code, _, err = finish(process)
    assert (code, err) == (0, "")
    with pytest.raises(ConnectionError):
        socket.create_connection(("127.0.0.1", port), timeout=10).close()
