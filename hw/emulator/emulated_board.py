"""An LED board behind a pseudo-terminal: real serial drivers talk to it as to a real one."""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from pathlib import Path
from types import TracebackType

import numpy as np

from hw.emulator.firmware import Firmware, make_firmware
from hw.leds import ProtocolName
from hw.leds.board import Levels, dark

STEP = 0.005
"""Seconds between looks at the clock, which the watchdog and greetings need."""


class EmulatedBoard:
    """A board at the path ``port``; a context manager.

    Arguments:
        port: where the port appears (a link to the pseudo-terminal).
        protocol: what it speaks.
        leds: how many LEDs it drives.
    """

    def __init__(
        self,
        port: Path,
        protocol: ProtocolName = ProtocolName.LINES,
        leds: int = 20,
    ) -> None:
        """Plug the board in."""
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
