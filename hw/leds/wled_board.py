"""A WLED controller: its JSON API over the serial port (WLED 0.13 and later), or the network.

Over the serial port ``"v": true`` in a request makes WLED answer with its state, which is our
acknowledgement; over the network its state is asked for after each request.
"""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from typing import Any, Protocol

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import Levels
from hw.leds.link import SerialLink

START_SECONDS = 5.0
"""How long a controller may take to start after the port's opening has reset it."""
SEGMENT = 0
LEDS_PER_REQUEST = 64
"""WLED reads requests into a small buffer; longer ones are dropped without a word."""
TRIES = 2


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

    def close(self) -> None:
        """Give the port back."""


class SerialWled:
    """WLED on an open serial line, which it takes over."""

    def __init__(self, link: SerialLink) -> None:
        self._link, self.port, self.timeout = link, link.port, link.timeout

    def ask(self, request: dict[str, object], seconds: float) -> dict[str, Any]:
        """Return the answer; anything else on the line is passed over."""
        self._link.forget()
        content = json.dumps({**request, "v": True}, separators=(",", ":"))
        self._link.write(content.encode() + b"\n")
        deadline = time.monotonic() + seconds
        while True:
            answer = _object_in(self._link.read_line(deadline))
            if isinstance(answer.get("state"), dict) and isinstance(answer.get("info"), dict):
                return answer

    def close(self) -> None:
        """Give the port back."""
        self._link.close()


class WledBoard:
    """The driver of WLED.

    It takes the ``link`` over.
    """

    def __init__(self, link: WledLink, *, start_seconds: float = START_SECONDS) -> None:
        """Ask who is there.

        Raises:
            PortError: nobody answers, or it is not WLED.
        """
        self._link = link
        self.dark_after: float | None = None
        info = self._identity(start_seconds)
        self.name = f"WLED {info['ver']}"
        self.leds = int(info["leds"]["count"])

    def show(self, levels: Levels) -> None:
        """Set every LED of the first segment; transitions off, brightness full."""
        for first in range(0, len(levels), LEDS_PER_REQUEST):
            part = levels[first : first + LEDS_PER_REQUEST].tolist()
            colors = [f"{red:02X}{green:02X}{blue:02X}" for red, green, blue in part]
            request = {
                "on": True,
                "bri": 255,
                "transition": 0,
                "seg": {"id": SEGMENT, "on": True, "bri": 255, "i": [first, *colors]},
            }
            self._accepted(request)

    def keep_alive(self) -> None:
        """Ask for the state: WLED has no watchdog, but a lost link shows."""
        self._link.ask({}, self._link.timeout)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _accepted(self, request: dict[str, object]) -> None:
        state = self._retried(request)["state"]
        if state.get("on") is not True or state.get("bri") != 255:
            raise ProtocolError(
                f"WLED on {self._link.port} answered on = {state.get('on')}, bri = "
                f"{state.get('bri')}, allowed: on at 255; lift its brightness limit in its "
                "settings",
                field="state",
            )

    def _retried(self, request: dict[str, object]) -> dict[str, Any]:
        for remaining in reversed(range(TRIES)):
            try:
                return self._link.ask(request, self._link.timeout)
            except UnpluggedError:
                raise
            except LinkError:
                if not remaining:
                    raise
        raise AssertionError("unreachable")

    def _identity(self, patience: float) -> dict[str, Any]:
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            try:
                info: dict[str, Any] = self._link.ask({}, 1.0)["info"]
            except UnpluggedError:
                raise
            except (LinkError, ProtocolError):
                # A network without a controller refuses at once.
                time.sleep(0.05)
                continue
            count = info.get("leds", {}).get("count")
            if isinstance(info.get("ver"), str) and isinstance(count, int) and count > 0:
                return info
        raise PortError(
            f"no WLED answers on {self._link.port}: choose another --port or --protocol, and see "
            "that the controller has power and, for a serial port, that serial is on in its sync "
            "settings",
            field="port",
        )


def _object_in(line: bytes) -> dict[str, Any]:
    """Return the JSON object on a line, empty where there is none."""
    start = line.find(b"{")
    try:
        found = json.loads(line[start:]) if start >= 0 else {}
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


class WebWled:
    """WLED at an ``http://`` address: its JSON API, ``/json/state`` and ``/json/info``.

    One answer may take ``timeout`` seconds.

    Raises:
        PortError: no such address.
    """

    def __init__(self, address: str, *, timeout: float = 1.0) -> None:
        self.port, self.timeout = address.rstrip("/"), timeout
        # Not through a proxy: the controller is on the rig's own network.
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            if not urllib.request.Request(self.port).host:
                raise ValueError("no host")
        except ValueError:
            raise PortError(
                f"{address} is not the address of a WLED, allowed: http://<name or number>; look "
                "it up in WLED's app",
                field="port",
            ) from None

    def ask(self, request: dict[str, object], seconds: float) -> dict[str, Any]:
        """Return WLED's state, after it has taken a ``request`` that is not empty, and its info.

        Raises:
            LinkError: no answer in time, or none that is WLED's.
        """
        deadline = time.monotonic() + seconds
        if request:
            self._exchange("state", deadline, json.dumps(request).encode())
        return {name: self._exchange(name, deadline) for name in ("state", "info")}

    def close(self) -> None:
        """Do nothing: every request has a connection of its own."""

    def _exchange(self, name: str, deadline: float, content: bytes | None = None) -> dict[str, Any]:
        """Return the object that ``/json/<name>`` answers."""
        request = urllib.request.Request(
            f"{self.port}/json/{name}", content, {"Content-Type": "application/json"}
        )
        remaining = max(deadline - time.monotonic(), 0.05)
        try:
            with self._opener.open(request, timeout=remaining) as answer:
                found = json.load(answer)
        except urllib.error.HTTPError as error:
            raise self._lost(f"answers {error.code} {error.reason}") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "reason", error)
            raise self._lost(f"does not answer as WLED does ({reason})") from None
        if not isinstance(found, dict):
            raise self._lost("does not answer as WLED does")
        return found

    def _lost(self, what: str) -> LinkError:
        return LinkError(
            f"the LED board on {self.port} {what}: check its power and network, then try again",
            field="port",
        )
