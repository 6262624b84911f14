"""WLED's two ways in, a serial line and HTTP: every answer is bounded in size and in time.

The JSON API is documented at https://kno.wled.ge/interfaces/json-api and /interfaces/serial.
"""

from __future__ import annotations

import io
import json
import socket
import ssl
import threading
import time
from contextlib import closing
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from queue import Empty, SimpleQueue
from typing import Any, NoReturn, Protocol
from urllib.parse import urlsplit

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.link import SerialLink

LONGEST_ANSWER = 256 * 1024
"""Bytes of one answer, headers included; WLED's longest, its settings, has some ten thousand."""


class WledLink(Protocol):
    """How WLED is reached.

    port: where it is. timeout: seconds that one answer may take.
    """

    port: str
    timeout: float

    def ask(self, request: dict[str, object], seconds: float) -> dict[str, Any]:
        """Return the answer ``{"state": ..., "info": ...}`` to ``request``, within ``seconds``.

        Raises:
            LinkError: none came.
        """

    def settings(self) -> dict[str, Any]:
        """Return its settings, empty where it does not tell them."""

    def pixels(self) -> list[object] | None:
        """Return what it holds for each LED, ``0xWWRRGGBB``, None where it does not tell."""

    def close(self) -> None:
        """Give the port back."""


class SerialWled:
    """WLED on an open serial line, which it takes over; its settings are not told there."""

    def __init__(self, link: SerialLink) -> None:
        self._link, self.port, self.timeout = link, link.port, link.timeout

    def ask(self, request: dict[str, object], seconds: float) -> dict[str, Any]:
        """Return the answer; anything else on the line is passed over."""
        content = json.dumps({**request, "v": True}, separators=(",", ":"))
        self._send(content.encode())
        deadline = time.monotonic() + seconds
        while True:
            line = self._link.read_line(deadline)
            try:
                return _state_and_info(line[max(line.find(b"{"), 0) :])
            except ValueError:
                continue

    def settings(self) -> dict[str, Any]:
        """Return nothing."""
        return {}

    def pixels(self) -> list[object] | None:
        """Return what the letter ``l`` makes WLED list."""
        deadline = time.monotonic() + self.timeout
        try:
            self._send(b"l")
            while True:
                line = self._link.read_line(deadline)
                if line.startswith(b"["):
                    found = _parsed(line)
                    return found if isinstance(found, list) else None
        except UnpluggedError:
            raise
        except (LinkError, ProtocolError, ValueError):
            return None

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _send(self, content: bytes) -> None:
        self._link.forget()
        self._link.write(content + b"\n")


class WebWled:
    """WLED at an ``http://`` address: ``/json/state``, ``/json/si`` and ``/json/cfg``.

    One answer may take ``timeout`` seconds. Redirects and proxies are not followed: the controller
    is on the rig's own network.

    Raises:
        PortError: no such address.
    """

    def __init__(self, address: str, *, timeout: float = 1.0) -> None:
        self.port, self.timeout = address.rstrip("/"), timeout
        try:
            parts = urlsplit(self.port)
            if not parts.hostname or parts.query or parts.fragment or parts.username is not None:
                raise ValueError("no plain address")
            self._host, self._number, self._root = parts.hostname, parts.port, parts.path
        except ValueError:
            raise PortError(
                f"{address} is not the address of a WLED, allowed: http://<name or number>; look "
                "it up in WLED's app",
                field="port",
            ) from None
        self._secure = parts.scheme == "https"

    def ask(self, request: dict[str, object], seconds: float) -> dict[str, Any]:
        """Return WLED's state, after it has taken a ``request`` that is not empty, and its info.

        Raises:
            LinkError: no answer in time, or none that is WLED's.
        """
        deadline = time.monotonic() + seconds
        if request:
            self._exchange("state", deadline, json.dumps(request).encode())
        found = self._exchange("si", deadline)
        try:
            return _state_and_info(found)
        except ValueError as error:
            raise self._foreign(error) from None

    def settings(self) -> dict[str, Any]:
        """Return its settings; a PIN, or a server on the way, may keep them."""
        try:
            found = _parsed(self._exchange("cfg", time.monotonic() + self.timeout))
        except (LinkError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def pixels(self) -> list[object] | None:
        """Return nothing: over the network only web sockets tell them."""
        return None

    def close(self) -> None:
        """Do nothing: every request has a connection of its own."""

    def _exchange(self, name: str, deadline: float, content: bytes | None = None) -> bytes:
        """Return what ``/json/<name>`` answers.

        In a thread, because looking a name up knows no deadline.
        """
        outcome: SimpleQueue[bytes | LinkError] = SimpleQueue()

        def work() -> None:
            outcome.put(self._outcome(f"{self._root}/json/{name}", deadline, content))

        threading.Thread(target=work, daemon=True).start()
        try:
            found = outcome.get(timeout=max(deadline - time.monotonic(), 0.0))
        except Empty:
            raise self._lost("did not answer in time") from None
        if isinstance(found, LinkError):
            raise found
        return found

    def _outcome(self, path: str, deadline: float, content: bytes | None) -> bytes | LinkError:
        """Return the answer's content, or what went wrong: all that can, ends here."""
        method = "GET" if content is None else "POST"
        headers = {"Content-Type": "application/json", "Connection": "close"}
        remaining = max(deadline - time.monotonic(), 0.001)
        try:
            with closing(self._connection(remaining)) as connection:
                connection.request(method, path, content, headers)
                answer = HTTPResponse(_BoundedSocket(connection.sock, deadline), method=method)  # type: ignore[arg-type]
                answer.begin()
                if answer.status != HTTPStatus.OK:
                    return self._lost(f"answers with HTTP status {answer.status}, allowed: 200")
                found = answer.read(LONGEST_ANSWER)
                if answer.length:
                    raise ValueError(f"{answer.length} bytes are missing")
                return found
        except TimeoutError:
            return self._lost("did not answer in time")
        except (OSError, HTTPException, ValueError) as error:
            return self._foreign(error)

    def _connection(self, seconds: float) -> HTTPConnection:
        if not self._secure:
            return HTTPConnection(self._host, self._number, timeout=seconds)
        context = ssl.create_default_context()
        return HTTPSConnection(self._host, self._number, timeout=seconds, context=context)

    def _foreign(self, error: Exception) -> LinkError:
        # What a stranger sent is shown as text, whatever a terminal would make of it.
        reason = ascii(str(error) or type(error).__name__)[1:-1][:80]
        return self._lost(f"does not answer as WLED does ({reason})")

    def _lost(self, what: str) -> LinkError:
        return LinkError(
            f"the LED board on {self.port} {what}: check its power and network, then try again",
            field="port",
        )


class _BoundedSocket(io.RawIOBase):
    """What an `HTTPResponse` reads: no byte after ``deadline``, and not too many."""

    def __init__(self, connected: socket.socket, deadline: float) -> None:
        self._socket, self._deadline, self._count = connected, deadline, 0

    def makefile(self, _: str) -> io.BufferedReader:
        """Return the reader that `HTTPResponse` asks a socket for."""
        return io.BufferedReader(self)

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what has come; every byte has the same deadline."""
        remaining = self._deadline - time.monotonic()
        if remaining <= 0:
            raise TimeoutError
        self._socket.settimeout(remaining)
        found = self._socket.recv_into(buffer)
        self._count += found
        if self._count > LONGEST_ANSWER:
            raise ValueError(f"more than {LONGEST_ANSWER} bytes")
        return found


def _state_and_info(content: bytes) -> dict[str, Any]:
    """Return an answer that holds the objects ``state`` and ``info``.

    Raises:
        ValueError: it is anything else.
    """
    found = _parsed(content)
    if not isinstance(found, dict) or not all(
        isinstance(found.get(name), dict) for name in ("state", "info")
    ):
        raise ValueError("no JSON object with state and info")
    return found


def _parsed(content: bytes) -> object:
    """Return what JSON ``content`` holds.

    Raises:
        ValueError: it is no JSON, or not such as can be read.
    """
    try:
        return json.loads(content, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("JSON that is nested too deep") from None


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")
