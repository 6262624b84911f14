"""From a design to LED levels: which LED feeds which fiber, and how much it may draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.errors import PowerError
from hw.leds.board import Levels, dark
from optimize.mounting.feeds import FULL_MILLIAMPERES
from render.arrays import Array

ORDERS = ("rgb", "rbg", "grb", "gbr", "brg", "bgr")


@dataclass(frozen=True)
class ChannelMap:
    """Which LED of the board feeds each fiber.

    Arguments:
        leds: ``(fiber,)`` number of the LED of each fiber, in the order of ``design.json``.
        order: how the LEDs' own channels are wired, ``rgb`` when as the board says.
    """

    leds: tuple[int, ...]
    order: str = "rgb"

    def __post_init__(self) -> None:
        """Refuse an LED that would feed two fibers, and unknown orders."""
        twice = [led for led in set(self.leds) if self.leds.count(led) > 1]
        if twice or min(self.leds, default=-1) < 0:
            raise PowerError(
                f"LED {min(twice, default=min(self.leds, default=-1))} is given "
                f"{'twice' if twice else 'but does not exist'}, allowed: one LED from 0 for each "
                "fiber; correct --leds",
                field="leds",
                value=self.leds,
            )
        if self.order not in ORDERS:
            raise PowerError(
                f"order = {self.order!r}, allowed: {', '.join(ORDERS)}; correct --order",
                field="order",
                value=self.order,
                allowed=", ".join(ORDERS),
            )

    @classmethod
    def straight(cls, fibers: int, first: int = 0, order: str = "rgb") -> ChannelMap:
        """Return the map of fiber ``i`` to LED ``first + i``."""
        return cls(tuple(range(first, first + fibers)), order)

    @classmethod
    def parse(cls, text: str | None, fibers: int, order: str) -> ChannelMap:
        """Return the map that ``--leds 0,1,5`` gives, the straight one without it."""
        if text is None:
            return cls.straight(fibers, order=order)
        try:
            leds = tuple(int(item) for item in text.split(","))
        except ValueError:
            leds = ()
        if len(leds) != fibers:
            raise PowerError(
                f"--leds {text} is not a list of {fibers} numbers, allowed: one LED for each "
                "fiber, like 0,1,2",
                field="leds",
                value=text,
            )
        return cls(leds, order)

    @property
    def needed(self) -> int:
        """How many LEDs the board must drive."""
        return max(self.leds) + 1

    def levels(self, power: Array, limits: PowerLimits) -> Levels:
        """Return the levels ``(led, 3)`` that give the fibers ``power`` ``(fiber, 3)`` in [0, 1].

        Raises:
            PowerError: out of range, or more current than ``limits`` allow.
        """
        power = np.asarray(power, dtype=np.float64)
        if power.shape != (len(self.leds), 3) or not ((power >= 0) & (power <= 1)).all():
            raise PowerError(
                f"power has shape {power.shape} and values {power.min():g} to {power.max():g}, "
                f"allowed: ({len(self.leds)}, 3) in 0 to 1; make the design for this rig",
                field="power",
            )
        limits.check(power)
        levels = dark(self.needed)
        channel = ["rgb".index(letter) for letter in self.order]
        levels[list(self.leds)] = np.rint(255 * power)[:, channel].astype(np.uint8)
        return levels


@dataclass(frozen=True)
class PowerLimits:
    """What the rig may draw: nothing is dimmed silently, too much is refused.

    Arguments:
        milliamperes: current of one channel of one LED at full power.
        total_milliamperes: what the supply may give; 500 mA is a USB port.
        highest: greatest power of one channel, in [0, 1].
    """

    milliamperes: float = FULL_MILLIAMPERES
    total_milliamperes: float = 500.0
    highest: float = 1.0

    def current(self, power: Array) -> float:
        """Return the current (mA) that ``power`` ``(fiber, 3)`` draws."""
        return float(np.sum(power)) * self.milliamperes

    def check(self, power: Array) -> None:
        """Refuse ``power`` ``(fiber, 3)`` beyond the limits.

        Raises:
            PowerError: says how much was asked for and how much is allowed.
        """
        if power.max(initial=0.0) > self.highest:
            raise PowerError(
                f"power = {power.max():g}, allowed: at most {self.highest:g}; lower --scale",
                field="power",
                value=float(power.max()),
                allowed=f"at most {self.highest:g}",
            )
        current = self.current(power)
        if current > self.total_milliamperes:
            raise PowerError(
                f"the lights would draw {current:.0f} mA, allowed: {self.total_milliamperes:.0f} "
                "mA; lower --scale, or raise --limit-ma if the supply gives more",
                field="current",
                value=current,
                allowed=f"at most {self.total_milliamperes:g} mA",
            )
