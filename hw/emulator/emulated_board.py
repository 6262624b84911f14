"""An LED board behind a pseudo-terminal: real serial drivers talk to it as to a real one.

What runs on it is written from the protocol pages, not from the drivers: it shares the checksum
with them, nothing else.
"""

from __future__ import annotations

import json
import os
import pty
import select
import threading
import time
import tty
from pathlib import Path
from typing import Protocol

import numpy as np

from hw.leds import ProtocolName
from hw.leds.board import Levels, dark
from hw.leds.line_board import MAKER, VERSION, crc8, framed


class Firmware(Protocol):
    """A board's program. shown: what its LEDs show, ``(led, 3)``."""

    shown: Levels

    def take(self, content: bytes, now: float) -> bytes:
        """Take what came over the line (often nothing) at ``now`` (s); return the answer."""


def make_firmware(protocol: ProtocolName, leds: int) -> Firmware:
    """Return the program of a board that speaks ``protocol``."""
    if protocol is ProtocolName.LINES:
        return LineFirmware(leds)
    if protocol is ProtocolName.WLED:
        return WledFirmware(leds)
    return AdalightFirmware(leds)


class LineFirmware:
    """The plain line protocol; mirrors the sketch in ``hw/firmware``."""

    LONGEST = 64

    def __init__(self, leds: int) -> None:
        self.shown, self._next = dark(leds), dark(leds)
        self._leds = leds
        self._buffer = b""
        self._watchdog, self._heard = 0.0, 0.0

    def take(self, content: bytes, now: float) -> bytes:
        """Answer every whole line; go dark when nothing came for too long."""
        if self._watchdog and now - self._heard > self._watchdog:
            self.shown, self._next = dark(self._leds), dark(self._leds)
        *lines, self._buffer = (self._buffer + content).split(b"\n")
        if len(self._buffer) > self.LONGEST:
            self._buffer = b""
        answer = b""
        for line in lines:
            self._heard = now
            answer += self._answer(line.rstrip(b"\r"))
        return answer

    def _answer(self, line: bytes) -> bytes:
        if line == b"*IDN?":
            return framed(f"{MAKER},{VERSION},emulated,{self._leds}")
        body, _, checksum = line.rpartition(b"*")
        number, *words = body.decode("ascii", "replace").split(" ")
        if checksum != b"%02X" % crc8(body):
            return framed(f"{number if number.isdecimal() else 0} ERR checksum")
        problem = self._obey(words)
        return framed(f"{number} ERR {problem}" if problem else f"{number} OK")

    def _obey(self, words: list[str]) -> str:
        """Do what a line says; return what is wrong with it, or nothing."""
        word, *rest = words or [""]
        try:
            numbers = [int(item) for item in rest]
        except ValueError:
            return "number"
        if word == "SET" and len(numbers) == 4:
            led, *color = numbers
            if not 0 <= led < self._leds or not all(0 <= level <= 255 for level in color):
                return "range"
            self._next[led] = color
        elif word == "SHOW" and not numbers:
            self.shown = self._next.copy()
        elif word == "OFF" and not numbers:
            self.shown, self._next = dark(self._leds), dark(self._leds)
        elif word == "WDT" and len(numbers) == 1:
            self._watchdog = numbers[0] / 1000
        elif word != "PING" or numbers:
            return "word"
        return ""


class WledFirmware:
    """As much of WLED as a driver of single LEDs meets."""

    def __init__(self, leds: int) -> None:
        self.shown = dark(leds)
        self._leds = leds
        self._buffer = b""
        self._state = {"on": True, "bri": 128, "transition": 7}

    def take(self, content: bytes, now: float) -> bytes:
        """Obey every whole JSON object; answer those that ask for it with ``v``."""
        *lines, self._buffer = (self._buffer + content).split(b"\n")
        answer = b""
        for line in lines:
            try:
                request = json.loads(line)
            except ValueError:
                continue
            self._obey(request)
            if request.get("v"):
                answer += self._answer()
        return answer

    def _obey(self, request: dict[str, object]) -> None:
        for key in ("on", "bri", "transition"):
            if key in request:
                self._state[key] = request[key]  # type: ignore[assignment]
        segment = request.get("seg")
        place = 0
        for item in segment.get("i", []) if isinstance(segment, dict) else []:
            if isinstance(item, int):
                place = item
                continue
            if place < self._leds:
                self.shown[place] = list(bytes.fromhex(item))
            place += 1

    def _answer(self) -> bytes:
        info = {"ver": "0.14.0", "leds": {"count": self._leds, "maxpwr": 850}, "name": "WLED"}
        return json.dumps({"state": self._state, "info": info}).encode() + b"\r\n"


class AdalightFirmware:
    """The classic sketch: says ``Ada`` every second of silence."""

    GREETING = 1.0

    def __init__(self, leds: int) -> None:
        self.shown = dark(leds)
        self._leds = leds
        self._buffer = b""
        self._spoke = float("-inf")

    def take(self, content: bytes, now: float) -> bytes:
        """Show every whole frame; greet in silence."""
        self._buffer += content
        while self._frame():
            pass
        if content:
            self._spoke = now
        if now - self._spoke < self.GREETING:
            return b""
        self._spoke = now
        return b"Ada\n"

    def _frame(self) -> bool:
        """Show the next frame of the buffer, if it is whole; return whether there may be more."""
        start = self._buffer.find(b"Ada")
        if start < 0:
            self._buffer = self._buffer[-2:]
            return False
        self._buffer = self._buffer[start:]
        if len(self._buffer) < 6:
            return False
        high, low, check = self._buffer[3:6]
        if check != high ^ low ^ 0x55:
            self._buffer = self._buffer[3:]
            return True
        size = 3 * (256 * high + low + 1)
        if len(self._buffer) < 6 + size:
            return False
        colors = np.frombuffer(self._buffer[6 : 6 + size], dtype=np.uint8).reshape(-1, 3)
        self.shown[: len(colors)] = colors[: self._leds]
        self._buffer = self._buffer[6 + size :]
        return True


STEP = 0.005
"""Seconds between looks at the clock, which the watchdog and greetings need."""


class EmulatedBoard:
    """A board at the path ``port``; a context manager.

    ``port`` is a link to the pseudo-terminal.
    """

    def __init__(
        self,
        port: Path,
        protocol: ProtocolName = ProtocolName.LINES,
        leds: int = 20,
    ) -> None:
        self.port, self.leds = port, leds
        self._protocol = protocol
        self._firmware = self.boot()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self.plug_in()

    def __enter__(self) -> EmulatedBoard:
        """Return the board."""
        return self

    def __exit__(self, *_: object) -> None:
        """Pull the plug for good."""
        self.unplug()

    @property
    def levels(self) -> Levels:
        """What the LEDs show now, ``(led, 3)``."""
        with self._lock:
            return self._firmware.shown.copy()

    def boot(self) -> Firmware:
        """Return the program as it starts when the board gets power."""
        return make_firmware(self._protocol, self.leds)

    def plug_in(self) -> None:
        """Connect the board; like most, it starts dark."""
        self._stop = threading.Event()
        master, slave = pty.openpty()
        tty.setraw(slave)
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(os.ttyname(slave))
        with self._lock:
            self._firmware = self.boot()
        self._thread = threading.Thread(
            target=self._serve, args=(master, slave, self._stop), daemon=True
        )
        self._thread.start()

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, and the LEDs are without power."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def wait_for(self, levels: Levels, seconds: float = 2.0) -> bool:
        """Return whether the LEDs come to show ``levels`` within ``seconds``."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if np.array_equal(self.levels, levels):
                return True
            time.sleep(STEP)
        return False

    def _serve(self, master: int, slave: int, stop: threading.Event) -> None:
        """Play the board until unplugged.

        The slave's descriptor stays open here: without it, the master would see an error as soon
        as no program has the port open.
        """
        try:
            while not stop.is_set():
                ready, _, _ = select.select([master], [], [], STEP)
                content = os.read(master, 4096) if ready else b""
                with self._lock:
                    answer = self._firmware.take(content, time.monotonic())
                if answer:
                    os.write(master, answer)
        finally:
            self.port.unlink(missing_ok=True)
            with self._lock:
                self._firmware.shown = dark(self.leds)
            os.close(slave)
            os.close(master)
