"""WLED as a web server on this machine: its JSON API, as its pages say."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from hw.emulator.wled_firmware import WLED_STATES, WledFirmware
from hw.leds.board import Levels


class WledServer:
    """What runs on the controller; ``address`` is where it listens.

    ``refuse`` makes it answer 503, as WLED does while another program holds its buffer.
    """

    def __init__(self, leds: int, state: str = "") -> None:
        self.firmware = WledFirmware(leds, WLED_STATES[state] if state else None)
        self.refuse = 0
        self.gets: list[str] = []
        self.posts: list[str] = []
        self.lock = threading.Lock()
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self._answer(server.page(self.path))

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                self._answer(server.post(self.path, body))

            def _answer(self, found: object | None) -> None:
                content = json.dumps({"error": 9} if found is None else found).encode()
                self.send_response(503 if found is None else 200)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                """Say nothing."""

        self.web = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.web.server_address[1]}"

    @property
    def shown(self) -> Levels:
        with self.lock:
            return self.firmware.shown.copy()

    def page(self, path: str) -> object | None:
        with self.lock:
            if self._refuses():
                return None
            self.gets.append(path)
            name = path.split("/")[-1]
            if name == "si":
                return {one: self.firmware.page(one) for one in ("state", "info")}
            return self.firmware.page(name)

    def post(self, path: str, body: bytes) -> object | None:
        with self.lock:
            if self._refuses():
                return None
            self.posts.append(path)
            self.firmware.take(body + b"\n", 0.0)
            return {"success": True}

    def _refuses(self) -> bool:
        self.refuse -= 1
        return self.refuse >= 0


@contextmanager
def wled_server(leds: int = 20, state: str = "") -> Iterator[WledServer]:
    """Run a controller in a state until the block ends."""
    server = WledServer(leds, state)
    thread = threading.Thread(target=server.web.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield server
    finally:
        server.web.shutdown()
        server.web.server_close()
        thread.join()
