"""The fibers' lights: set by fiber, and off whenever the program leaves, for whatever reason."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from hw.errors import HardwareError, LinkError, PortError
from hw.leds.board import Board, Levels, dark
from hw.leds.channels import ChannelMap, PowerLimits
from render.arrays import Array


class FiberLights:
    """A context manager around a board; on leaving it, all LEDs are off.

    Where the link is lost, it is opened again for ``patience`` seconds, first of all to switch
    everything off; where that fails too, the error says whether the board goes dark by itself.

    ``connect`` opens the board, again when the link is lost.
    """

    def __init__(
        self,
        connect: Callable[[], Board],
        channels: ChannelMap,
        limits: PowerLimits | None = None,
        *,
        patience: float = 5.0,
    ) -> None:
        self._connect, self.channels = connect, channels
        self.limits = limits or PowerLimits()
        self._patience = patience
        self._board = connect()
        self._lost = False
        self._shown: Levels = dark(channels.needed)
        try:
            self._board.show(self._shown)
        except BaseException:
            self._board.close()
            raise

    @property
    def lit(self) -> int:
        """How many fibers have an LED that is on."""
        return self.channels.lit(self._shown)

    @property
    def board(self) -> Board:
        """The board, as long as it is connected."""
        return self._board

    def __enter__(self) -> FiberLights:
        """Return the lights."""
        return self

    def __exit__(self, _: object, error: object, __: object) -> None:
        """Switch everything off, also after an error, and give the port back."""
        try:
            # A board that was given up has been waited for already.
            if not self._lost:
                self.off()
        except HardwareError:
            # What went wrong first is what the user must hear.
            if error is None:
                raise
        finally:
            self._board.close()

    def set(self, power: Array) -> None:
        """Give the fibers ``power`` ``(fiber, color)`` in [0, 1].

        Raises:
            PowerError: more than the rig may draw.
            LinkError: the board is lost and did not come back.
        """
        self._show(self.channels.levels(power, self.limits))

    def off(self) -> None:
        """Switch all LEDs off."""
        self._show(dark(self.channels.needed))

    def hold(self, seconds: float | None) -> None:
        """Keep the light as it is for ``seconds`` (None: until interrupted)."""
        until = None if seconds is None else time.monotonic() + seconds
        step = min(0.5, (self._board.dark_after or 2.0) / 4)
        while until is None or time.monotonic() < until:
            pause = step if until is None else min(step, until - time.monotonic())
            time.sleep(max(pause, 0.0))
            try:
                self._board.keep_alive()
            except LinkError:
                self._recover(self._shown)

    def _show(self, levels: Levels) -> None:
        try:
            self._board.show(levels)
        except LinkError:
            self._recover(levels)
        self._shown, self._lost = levels, False

    def _recover(self, levels: Levels) -> None:
        """Open the board again; first dark, because nobody knows what it shows, then ``levels``."""
        self._board.close()
        deadline, pause = time.monotonic() + self._patience, 0.1
        while True:
            try:
                self._board = self._connect()
                self._board.show(dark(self.channels.needed))
                self._board.show(levels)
                return
            except (PortError, LinkError):
                self._board.close()
                if time.monotonic() + pause > deadline:
                    raise self._given_up() from None
            time.sleep(pause)
            pause = min(2 * pause, 1.0)

    def _given_up(self) -> LinkError:
        self._lost = True
        after = self._board.dark_after
        then = (
            f"its LEDs go dark by themselves within {after:g} s"
            if after is not None
            else "its LEDs may still be on, so cut their power"
        )
        return LinkError(
            f"the LED board was lost and did not come back in {self._patience:g} s ({then}): check "
            "cable and power, then try again",
            field="port",
        )


def sweep(lights: FiberLights, power: Array, settle: float = 0.0) -> Iterator[int]:
    """Light one fiber after the other with its part of ``power`` ``(fiber, color)``.

    Yields the number of the fiber that is lit; fibers without power are passed over. Dark again
    when it ends.

    ``settle`` is seconds between setting a light and yielding, for the camera's sake.
    """
    for fiber, alone in one_by_one(power):
        lights.set(alone)
        lights.hold(settle)
        yield fiber
    lights.off()


def one_by_one(power: Array) -> Iterator[tuple[int, Array]]:
    """Yield each fiber that has some of ``power`` ``(fiber, color)``, and its part alone."""
    for fiber in np.flatnonzero(np.asarray(power).max(axis=1) > 0).tolist():
        alone = np.zeros_like(power)
        alone[fiber] = power[fiber]
        yield fiber, alone
