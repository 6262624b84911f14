"""An emulated board that does wrong on purpose: what a driver must recover from, or name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hw.emulator.emulated_board import EmulatedBoard, Firmware
from hw.leds import ProtocolName
from hw.leds.board import Levels
from hw.leds.line_board import framed, unframed

GARBAGE = b"\x00\xff\x7fE (boot) \xc3\x28\n"


@dataclass
class BoardFaults:
    """Faults to inject; counted down as they happen, so that a driver can be seen to recover.

    Arguments:
        silent: so many answers are swallowed.
        partial: so many answers are cut in the middle, without a line end.
        garbage: before so many answers come bytes that mean nothing.
        wrong: so many answers acknowledge another request than the one that was made.
        corrupt: so many requests arrive with a flipped bit.
        unplug_after: bytes after which the cable is pulled, in the middle of a frame.
        refuse: every request is refused with this reason.
    """

    silent: int = 0
    partial: int = 0
    garbage: int = 0
    wrong: int = 0
    corrupt: int = 0
    unplug_after: int | None = None
    refuse: str = ""

    def take(self, name: str) -> bool:
        """Return whether the fault happens now, and count it."""
        count = int(getattr(self, name))
        if count > 0:
            setattr(self, name, count - 1)
        return count > 0


class FaultyBoard(EmulatedBoard):
    """An emulated board with `faults`."""

    def __init__(self, port: Path, protocol: ProtocolName, leds: int, faults: BoardFaults) -> None:
        self.faults = faults
        super().__init__(port, protocol, leds)

    def boot(self) -> Firmware:
        return FaultyFirmware(super().boot(), self._protocol, self.faults, self.unplug)


class FaultyFirmware:
    """A program between whose requests and answers faults happen, one request at a time."""

    def __init__(
        self,
        firmware: Firmware,
        protocol: ProtocolName,
        faults: BoardFaults,
        unplug: Callable[[], None],
    ) -> None:
        self._firmware, self._protocol, self._faults = firmware, protocol, faults
        self._unplug = unplug
        self._taken, self._rest = 0, b""

    @property
    def shown(self) -> Levels:
        return self._firmware.shown

    @shown.setter
    def shown(self, levels: Levels) -> None:
        self._firmware.shown = levels

    def take(self, content: bytes, now: float) -> bytes:
        self._taken += len(content)
        if self._faults.unplug_after is not None and self._taken >= self._faults.unplug_after:
            self._faults.unplug_after = None
            self._unplug()
            return b""
        if self._protocol is ProtocolName.ADALIGHT:
            return self._mangled(self._firmware.take(content, now))
        *lines, self._rest = (self._rest + content).split(b"\n")
        if not lines:
            return self._firmware.take(b"", now)
        return b"".join(self._mangled(self._answer(line, now)) for line in lines)

    def _answer(self, line: bytes, now: float) -> bytes:
        if self._protocol is ProtocolName.WLED:
            if self._faults.take("corrupt"):
                line = line[1:]
            elif self._faults.refuse:
                request = json.loads(line)
                settings = ("on", "bri", "transition")
                line = json.dumps({k: v for k, v in request.items() if k not in settings}).encode()
            return self._firmware.take(line + b"\n", now)
        if line == b"*IDN?":
            return self._firmware.take(line + b"\n", now)
        if self._faults.take("corrupt"):
            line = bytes([line[0] ^ 1, *line[1:]])
        elif self._faults.refuse:
            return framed(f"{line.split()[0].decode()} ERR {self._faults.refuse}")
        answer = self._firmware.take(line + b"\n", now)
        if self._faults.take("wrong"):
            number, _, said = unframed(answer.rstrip()).partition(" ")
            answer = framed(f"{(int(number) + 7) % 256} {said}")
        return answer

    def _mangled(self, answer: bytes) -> bytes:
        if not answer or self._faults.take("silent"):
            return b""
        if self._faults.take("partial"):
            return answer[: len(answer) // 2]
        return GARBAGE + answer if self._faults.take("garbage") else answer
