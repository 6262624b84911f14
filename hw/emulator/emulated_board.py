"""An LED board behind a pseudo-terminal: real serial drivers talk to it as to a real one.

What runs on it is written from the protocol pages, not from the drivers: it shares the checksum
with them, nothing else.
"""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from pathlib import Path
from typing import Protocol

import numpy as np

from hw.emulator.wled_firmware import WLED_STATES, WledFirmware
from hw.leds import ProtocolName
from hw.leds.board import Levels, dark
from hw.leds.line_board import MAKER, crc8, framed


class Firmware(Protocol):
    """A board's program. shown: what its LEDs show, ``(led, 3)``."""

    shown: Levels

    def take(self, content: bytes, now: float) -> bytes:
        """Take what came over the line (often nothing) at ``now`` (s); return the answer."""


LINE_STATES: dict[str, dict[str, int]] = {
    "dimmed": {"brightness": 128},
    "collapsing": {"most": 6},
    "version-1": {"version": 1},
}
"""By its name, what makes a `LineFirmware` show less than it is told, or say less."""


def states_of(protocol: ProtocolName) -> list[str]:
    """Return the names of the states in which a board that speaks ``protocol`` can be."""
    return {
        ProtocolName.LINES: sorted(LINE_STATES),
        ProtocolName.WLED: sorted(WLED_STATES),
        ProtocolName.ADALIGHT: [],
    }[protocol]


def make_firmware(protocol: ProtocolName, leds: int, state: str = "") -> Firmware:
    """Return the program of a board that speaks ``protocol``, in one of its `states_of`."""
    if protocol is ProtocolName.LINES:
        return LineFirmware(leds, **LINE_STATES[state] if state else {})
    if protocol is ProtocolName.WLED:
        return WledFirmware(leds, WLED_STATES[state] if state else None)
    return AdalightFirmware(leds)


class LineFirmware:
    """The plain line protocol; mirrors the sketch in ``hw/firmware``.

    Its sketch sets a ``brightness``, its supply collapses beyond ``most`` LEDs, and the board
    starts anew, or it has an older ``version``.
    """

    LONGEST = 64
    COLORS = 8

    def __init__(
        self, leds: int, *, brightness: int = 255, most: int | None = None, version: int = 2
    ) -> None:
        self._brightness, self._version = brightness, version
        self._most = leds if most is None else most
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
            return framed(f"{MAKER},{self._version},emulated,{self._leds}")
        body, _, checksum = line.rpartition(b"*")
        number, *words = body.decode("ascii", "replace").split(" ")
        if checksum != b"%02X" % crc8(body):
            return framed(f"{number if number.isdecimal() else 0} ERR checksum")
        if words[:1] == ["GET"] and self._version > 1:
            return framed(f"{number} {self._told(words[1:])}")
        problem = self._obey(words)
        return framed(f"{number} ERR {problem}" if problem else f"{number} OK")

    def _told(self, rest: list[str]) -> str:
        """Return the answer to GET: the colors of some LEDs from one on."""
        try:
            numbers = [int(item) for item in rest]
        except ValueError:
            return "ERR number"
        if len(numbers) != 1:
            return "ERR word"
        first = numbers[0]
        if not 0 <= first < self._leds:
            return "ERR range"
        return f"OK {self.shown[first : first + self.COLORS].tobytes().hex().upper()}"

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
            if self._next.any(axis=1).sum() > self._most:
                self._next, self._watchdog = dark(self._leds), 0.0
            self.shown = (self._next * (self._brightness + 1.0) / 256).astype(np.uint8)
        elif word == "OFF" and not numbers:
            self.shown, self._next = dark(self._leds), dark(self._leds)
        elif word == "WDT" and len(numbers) == 1:
            self._watchdog = numbers[0] / 1000
        elif word != "PING" or numbers:
            return "word"
        return ""


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

    ``port`` is a link to the pseudo-terminal, ``state`` one of `states_of` its protocol.
    """

    def __init__(
        self,
        port: Path,
        protocol: ProtocolName = ProtocolName.LINES,
        leds: int = 20,
        state: str = "",
    ) -> None:
        self.port, self.leds = port, leds
        self._protocol, self._state = protocol, state
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
        return make_firmware(self._protocol, self.leds, self._state)

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
