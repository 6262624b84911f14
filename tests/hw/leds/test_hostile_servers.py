"""Whatever a server answers ends in one sentence, in the stated time."""

from __future__ import annotations

import gzip
import json
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from hw.emulator.wled_firmware import WledFirmware
from hw.errors import HardwareError, LinkError, PortError
from hw.leds import ProtocolName
from hw.leds.channels import ChannelMap
from hw.leds.fiber_lights import FiberLights
from hw.leds.ports import open_board
from hw.leds.wled_board import WledBoard
from hw.leds.wled_link import LONGEST_ANSWER, WebWled
from optimize.design import Design, save_design
from render.scene import load_scene
from tests.conftest import Run
from tests.hw.wled_server import WledServer, wled_server

ROOT = Path(__file__).parents[3]
START, SLACK = 0.15, 1.5
GOOD = {name: WledFirmware(20).page(name) for name in ("state", "info")}
Serve = Callable[[socket.socket], None]


def answer(body: bytes, status: str = "200 OK", *headers: str, length: object = None) -> bytes:
    """Return an HTTP answer."""
    lines = [f"HTTP/1.1 {status}", "Content-Type: application/json", *headers]
    lines.append(f"Content-Length: {len(body) if length is None else length}")
    return "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n" + body


def chunked(body: bytes) -> bytes:
    return b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + body


def told(**changes: object) -> bytes:
    return answer(json.dumps({**GOOD, **changes}).encode())


def info(**changes: object) -> bytes:
    return told(info={**GOOD["info"], **changes})  # type: ignore[dict-item]


def deep(depth: int) -> bytes:
    """Return an answer that JSON can just read, but not everything can walk through."""
    return answer(b'{"state": {}, "info": {"ver": ' + b"[" * depth + b"]" * depth + b"}}")


ELSEWHERE = "Location: http://127.0.0.1:9/json/si"
BODY = json.dumps(GOOD).encode()
ANSWERS: dict[str, bytes] = {
    "nothing": b"",
    "half a status": b"HTTP/1.1 2",
    "no HTTP": b"SSH-2.0-OpenSSH_9.6\r\n",
    "a terminal's commands": b"\x1b]0;owned\x07\x1b[2J\r\n",
    "a status with commands": answer(b"", "418 \x1b[2J\x1b]0;owned\x07"),
    "a status that is no number": b"HTTP/1.1 OK 200\r\n\r\n{}",
    "a status of many digits": b"HTTP/1.1 " + b"2" * 5000 + b"\r\n\r\n",
    "a line without end": b"HTTP/1.1 200 OK\r\nX: " + b"x" * 100_000,
    "many headers": b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 5000 + b"\r\n" + BODY,
    "a body cut off": answer(BODY[:50], length=len(BODY)),
    "a body cut off by one byte": answer(BODY, length=len(BODY) + 1),
    "a length that is no number": answer(BODY[:-1], length="many"),
    "a length below 0": answer(BODY[:-1], length=-5),
    "a length of a terabyte": answer(BODY, length=10**12),
    "a length of 5000 digits": answer(BODY[:-1], length="9" * 5000),
    "two lengths": answer(BODY, "200 OK", "Content-Length: 3"),
    "a chunk that is no number": chunked(b"zz\r\n{}\r\n0\r\n\r\n"),
    "a chunk below 0": chunked(b"-5\r\n{}\r\n0\r\n\r\n"),
    "a chunk of everything": chunked(b"-1\r\n{}\r\n0\r\n\r\n"),
    "a chunk of a terabyte": chunked(b"ffffffffff\r\n{}"),
    "a chunk cut off": chunked(b"20\r\n{}"),
    "chunks without end": chunked(b"2\r\n{}\r\n"),
    "a gzip bomb": answer(gzip.compress(b"0" * 10**7), "200 OK", "Content-Encoding: gzip"),
    "moved": answer(b"", "301 Moved Permanently", ELSEWHERE),
    "found": answer(b"", "302 Found", ELSEWHERE),
    "see other": answer(b"", "303 See Other", ELSEWHERE),
    "temporary": answer(b"", "307 Temporary Redirect", ELSEWHERE),
    "no content": b"HTTP/1.1 204 No Content\r\n\r\n",
    "unauthorized": answer(b"{}", "401 Unauthorized", 'WWW-Authenticate: Basic realm="x"'),
    "not found": answer(b"{}", "404 Not Found"),
    "an error": answer(b"{}", "500 Internal Server Error"),
    "busy": answer(b'{"error":3}', "503 Service Unavailable"),
    "switching protocols": b"HTTP/1.1 101 Switching Protocols\r\n\r\n",
    "HTML": answer(b"<html>router login</html>"),
    "half of JSON": answer(BODY[:-1]),
    "no UTF-8": answer(b'{"state": {"\xff\xfe": 1}}'),
    "UTF-16": answer('{"state": {}}'.encode("utf-16")),
    "deep lists": answer(b"[" * 100_000),
    "deep objects": answer(b'{"state":' * 20_000),
    "a number of 100000 digits": answer(b'{"state": {}, "info": {"n": ' + b"9" * 100_000 + b"}}"),
    "not a number": answer(b'{"state": {}, "info": {"n": NaN}}'),
    "infinity": answer(b'{"state": {}, "info": {"n": -Infinity}}'),
    **{f"JSON {body.decode()}": answer(body)
       for body in (b"null", b"true", b"3", b'"on"', b"[]", b"{}", b'{"state": {}}')},
    "a state that is a list": told(state=[]),
    "info that is text": told(info="info"),
    **{f"a version {depth} lists deep": deep(depth) for depth in (500, 900, 950, 980)},
    "no version": info(ver=None),
    "a version with commands": info(ver="\x1b[2J"),
    "a version of a megabyte": info(ver="0" * 200_000),
    "a version that is a list": info(ver=[0, 14]),
    **{f"{name} LEDs": info(leds={"count": count})
       for name, count in (("no", 0), ("minus one", -1), ("true", True), ("half", "20"),
                           ("a million", 1_000_001), ("1e300", 1e300), ("many", 10**300))},
    "LEDs that are a list": info(leds=[20]),
}  # fmt: skip


def once(content: bytes) -> Serve:
    return lambda connection: connection.sendall(content)


def heard(serve: Serve) -> Serve:
    """Return ``serve`` once the request has come."""

    def after(connection: socket.socket) -> None:
        connection.recv(65536)
        serve(connection)

    return after


def silent(connection: socket.socket) -> None:
    connection.recv(1)
    time.sleep(START + SLACK)


def dripping(connection: socket.socket) -> None:
    for one in answer(b" " * 10_000 + BODY):
        connection.sendall(bytes([one]))
        time.sleep(0.02)


def dripping_headers(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    for number in range(1000):
        connection.sendall(f"X-{number}: y\r\n".encode())
        time.sleep(0.02)


def continuing(connection: socket.socket) -> None:
    while True:
        connection.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")


def flooding(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        connection.sendall(b" " * 65536)


def flooding_chunks(connection: socket.socket) -> None:
    connection.sendall(chunked(b""))
    while True:
        connection.sendall(b"10000\r\n" + b" " * 65536 + b"\r\n")


def half_closed(connection: socket.socket) -> None:
    connection.sendall(answer(BODY)[:200])
    connection.shutdown(socket.SHUT_WR)
    time.sleep(START + SLACK)


def resetting(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")


def open_after_answer(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n" + BODY)
    time.sleep(START + SLACK)


BEHAVIORS = {name: once(content) for name, content in ANSWERS.items()} | {
    "silent": silent,
    "dripping": dripping,
    "dripping headers": dripping_headers,
    "always going on": continuing,
    "flooding": flooding,
    "flooding in chunks": flooding_chunks,
    "half closed": half_closed,
    "resetting": resetting,
    "open after the answer": open_after_answer,
}


@contextmanager
def served(serve: Serve) -> Iterator[str]:
    """Answer every connection as ``serve`` does; give the address."""
    listener = socket.create_server(("127.0.0.1", 0))

    def one(connection: socket.socket) -> None:
        with closing(connection), suppress(OSError):
            connection.settimeout(5.0)
            serve(connection)

    def accept() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=one, args=(listener.accept()[0],), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def sentence(error: BaseException) -> str:
    """Return what is said, seen to be one short line that a terminal takes as text."""
    said = str(error)
    assert said.isprintable()
    assert len(said) < 450
    return said


@pytest.mark.parametrize("name", sorted(BEHAVIORS))
def test_a_server_that_is_no_wled_ends_in_one_sentence_in_time(name: str) -> None:
    with served(heard(BEHAVIORS[name])) as address:
        began = time.monotonic()
        with pytest.raises(PortError, match="no WLED answers on") as told:
            WledBoard(WebWled(address, timeout=0.3), start_seconds=START)
        assert time.monotonic() - began < START + SLACK
    sentence(told.value)


@pytest.mark.parametrize("name", ["dripping", "flooding", "found", "a body cut off", "deep lists"])
@pytest.mark.parametrize("page", ["state", "si"])
def test_a_wled_that_turns_bad_ends_in_one_sentence_in_time(name: str, page: str) -> None:
    with wled_server() as server, turning_bad(server, page, BEHAVIORS[name]) as (address, turn):
        board = WledBoard(WebWled(address, timeout=0.3))
        turn.set()
        began = time.monotonic()
        # Where the answer to a change is damaged, the state that is read back tells.
        with pytest.raises(HardwareError, match=r"then try again|state\.on = False") as told:
            board.show(np.full((20, 3), 9, dtype=np.uint8))
        assert time.monotonic() - began < 4 * 0.3 + SLACK
    sentence(told.value)


@contextmanager
def turning_bad(
    server: WledServer, page: str, serve: Serve
) -> Iterator[tuple[str, threading.Event]]:
    """Pass requests on to a controller; those of ``page`` go wrong once the event is set."""
    turn = threading.Event()
    real = server.web.server_address

    def pass_on(connection: socket.socket) -> None:
        request = connection.recv(65536)
        if turn.is_set() and f"/json/{page} ".encode() in request:
            serve(connection)
            return
        with socket.create_connection(real) as behind:
            behind.sendall(request)
            behind.settimeout(0.2)
            with suppress(TimeoutError):
                if request.startswith(b"POST") and request.endswith(b"\r\n\r\n"):
                    behind.sendall(connection.recv(65536))
                while found := behind.recv(65536):
                    connection.sendall(found)

    with served(pass_on) as address:
        yield address, turn


@pytest.mark.parametrize(
    "name", ["a body cut off", "flooding", "HTML", "unauthorized", "deep lists"]
)
def test_settings_that_cannot_be_read_are_said_to_be_unread(name: str) -> None:
    with wled_server() as server, turning_bad(server, "cfg", BEHAVIORS[name]) as (address, turn):
        turn.set()
        board = WledBoard(WebWled(address, timeout=0.5))
        board.show(np.full((20, 3), 9, dtype=np.uint8))
        assert "gamma correction" in board.unread


def test_tls_on_the_port_ends_in_one_sentence_either_way(tmp_path: Path) -> None:
    made = subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "key.pem",
         "-out", "cert.pem", "-days", "2", "-subj", "/CN=wled"],
        cwd=tmp_path, capture_output=True, check=False,
    )  # fmt: skip
    if made.returncode:
        pytest.skip("no openssl on this machine")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")

    def serve(connection: socket.socket) -> None:
        with suppress(ssl.SSLError), context.wrap_socket(connection, server_side=True) as secure:
            secure.recv(65536)
            secure.sendall(answer(BODY))

    with served(serve) as address:
        for scheme in ("http", "https"):
            with pytest.raises(PortError, match="no WLED answers on") as told:
                WledBoard(WebWled(address.replace("http", scheme)), start_seconds=START)
            sentence(told.value)
    with (
        served(heard(once(answer(BODY)))) as address,
        pytest.raises(PortError, match="no WLED answers"),
    ):
        WledBoard(WebWled(address.replace("http", "https")), start_seconds=START)


@pytest.mark.parametrize(
    "address",
    ["http://127.0.0.1:99999", "http://127.0.0.1:x", "http://[::1", "http://", "http://a:b@c",
     "http://h/?x=1", "http://h#x"],
)  # fmt: skip
def test_what_is_no_address_is_refused_before_anything_is_asked(address: str) -> None:
    with pytest.raises(PortError, match="is not the address of a WLED"):
        WebWled(address)


@pytest.mark.parametrize(
    "address", ["http://no.such.name.invalid", "http://a b", "http://\u00e4\u00df.invalid/\u00e4",
                "http://" + 300 * "x", "http://..", "http://h\x7f", "http://127.0.0.1:9/a b"],
)  # fmt: skip
def test_an_address_that_leads_nowhere_ends_in_one_sentence_in_time(address: str) -> None:
    began = time.monotonic()
    with pytest.raises(HardwareError) as told:
        WledBoard(WebWled(address), start_seconds=START)
    assert time.monotonic() - began < START + SLACK
    assert str(told.value).count("\n") == 0


def test_a_name_that_is_looked_up_for_ever_ends_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # No name server here can be told to stay silent.
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: time.sleep(3.0) or [])
    began = time.monotonic()
    with pytest.raises(PortError, match="did not answer in time"):
        WledBoard(WebWled("http://wled.local"), start_seconds=START)
    assert time.monotonic() - began < START + SLACK


@pytest.mark.parametrize("status", ["301 Moved", "302 Found", "307 Temporary", "308 Permanent"])
def test_a_redirect_is_not_followed(status: str) -> None:
    with wled_server() as elsewhere:
        moved = answer(b"", status, f"Location: {elsewhere.address}/json/si")
        with (
            served(heard(once(moved))) as address,
            pytest.raises(PortError, match=f"answers with HTTP status {status[:3]}, allowed: 200"),
        ):
            WledBoard(WebWled(address), start_seconds=START)
        assert not elsewhere.gets


@pytest.mark.parametrize("size", [LONGEST_ANSWER - 4096, LONGEST_ANSWER + 1, 10 * LONGEST_ANSWER])
def test_no_more_is_read_than_the_longest_answer(size: int) -> None:
    content = answer(BODY + b" " * (size - len(BODY)))
    with served(heard(once(content))) as address:
        link = WebWled(address)
        if size < LONGEST_ANSWER:
            assert link.ask({}, 1.0)["info"]["ver"] == "0.14.0"
            return
        with pytest.raises(LinkError, match=r"more than 262144 bytes|bytes are missing"):
            link.ask({}, 1.0)


def test_a_board_that_was_given_up_is_not_waited_for_twice() -> None:
    with wled_server() as server, turning_bad(server, "si", silent) as (address, turn):
        link = WebWled(address, timeout=0.2)

        def connect() -> WledBoard:
            return WledBoard(link, start_seconds=0.5)

        began = time.monotonic()

        def lose() -> None:
            with FiberLights(connect, ChannelMap.straight(20), patience=0.5) as lights:
                turn.set()
                lights.set(np.eye(3)[np.arange(20) % 3])

        with pytest.raises(LinkError, match=r"did not come back in 0\.5 s"):
            lose()
        assert time.monotonic() - began < 2 * 0.2 + 2 * 0.5 + SLACK


def test_the_command_says_one_sentence_and_exits_with_2(tactilux: Run, tmp_path: Path) -> None:
    design = Design.of_colors(np.full(20, np.pi / 2), (np.arange(20) % 3).tolist())
    save_design(tmp_path / "design.json", design, load_scene("finger20"))
    with wled_server(state="limiter") as server:
        result = tactilux("hw", "set", tmp_path / "design.json", "--protocol", "wled",
                          "--port", server.address, "--seconds", "0")  # fmt: skip
        assert not server.shown.any()
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "info.leds.pwr" in result.err
    assert "fibers" not in result.err


@pytest.mark.slow
def test_the_process_ends_though_the_server_drips() -> None:
    with served(heard(dripping)) as address:
        done = subprocess.run(
            [sys.executable, "-m", "hw.cli", "hw", "off", "--protocol", "wled", "--port", address],
            cwd=ROOT, capture_output=True, text=True, check=False, timeout=30,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "did not answer in time" in done.stderr


def test_open_board_takes_an_address_with_a_path() -> None:
    with wled_server() as server:
        board = open_board(server.address + "/behind/a/proxy/", ProtocolName.WLED, leds=20)
        board.show(np.full((20, 3), 9, dtype=np.uint8))
