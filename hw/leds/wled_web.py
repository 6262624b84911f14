"""WLED over the network: its JSON API over HTTP, ``/json/state`` and ``/json/info``."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from typing import Any

from hw.errors import LinkError, PortError


class WebWled:
    """WLED at an address.

    Arguments:
        address: like ``http://192.168.4.1``.
        timeout: seconds that one answer may take.

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
                value=address,
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
            value=self.port,
        )
