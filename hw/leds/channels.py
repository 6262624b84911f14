"""From a design to LED levels: which LED feeds which fiber, and how much it may draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.errors import PowerError
from hw.leds.board import Levels, dark
from optimize.design import FULL_MILLIAMPERES
from optimize.mounting import FULL_LEVEL, Feeds, leds_per_fiber
from render.arrays import Array

ORDERS = ("rgb", "rbg", "grb", "gbr", "brg", "bgr")


@dataclass(frozen=True)
class ChannelMap:
    """Which LED of the board feeds each fiber.

    ``leds`` ``(fiber,)`` are in the order of ``design.json``; ``order`` is how the LEDs' own
    channels are wired, ``rgb`` when as the board says. An LED has three channels; where a fiber has
    more ``colors``, every number stands for as many LEDs as it takes, see `Feeds`.
    """

    leds: tuple[int, ...]
    order: str = "rgb"
    colors: int = 3

    def __post_init__(self) -> None:
        """Refuse an LED that would feed two fibers, and unknown orders."""
        twice = [led for led in set(self.leds) if self.leds.count(led) > 1]
        if twice or min(self.leds, default=-1) < 0:
            raise PowerError(
                f"LED {min(twice, default=min(self.leds, default=-1))} is given "
                f"{'twice' if twice else 'but does not exist'}, allowed: one LED from 0 for each "
                "fiber; correct --leds",
                field="leds",
            )
        if self.order not in ORDERS:
            raise PowerError(
                f"order = {self.order!r}, allowed: {', '.join(ORDERS)}; correct --order",
                field="order",
            )

    @classmethod
    def straight(cls, fibers: int, order: str = "rgb", colors: int = 3) -> ChannelMap:
        """Return the map of fiber ``i`` to LED ``i``."""
        return cls(tuple(range(fibers)), order, colors)

    @classmethod
    def parse(cls, text: str | None, fibers: int, order: str, colors: int = 3) -> ChannelMap:
        """Return the map that ``--leds 0,1,5`` gives, the straight one without it."""
        if text is None:
            return cls.straight(fibers, order, colors)
        try:
            leds = tuple(int(item) for item in text.split(","))
        except ValueError:
            leds = ()
        if len(leds) != fibers:
            raise PowerError(
                f"--leds {text} is not a list of {fibers} numbers, allowed: one LED for each "
                "fiber, like 0,1,2",
                field="leds",
            )
        return cls(leds, order, colors)

    @property
    def needed(self) -> int:
        """How many LEDs the board must drive."""
        return (max(self.leds) + 1) * leds_per_fiber(self.colors)

    def led(self, fiber: int, color: int) -> int:
        """Return the number of the LED that lights ``fiber`` in ``color``."""
        return Feeds(self.leds, self.order).channel(fiber, color, self.colors)[0]

    def lit(self, levels: Levels) -> int:
        """Return how many fibers have an LED that ``levels`` ``(led, 3)`` switch on."""
        each = leds_per_fiber(self.colors)
        return sum(bool(levels[led * each : (led + 1) * each].any()) for led in self.leds)

    def levels(self, power: Array, limits: PowerLimits) -> Levels:
        """Return the levels ``(led, 3)`` that give the fibers ``power`` ``(fiber, color)``.

        Powers are in [0, 1], of the LEDs of every fiber.

        Raises:
            PowerError: out of range, or more current than ``limits`` allow.
        """
        power = np.asarray(power, dtype=np.float64)
        expected = (len(self.leds), self.colors)
        if power.shape != expected or not ((power >= 0) & (power <= 1)).all():
            raise PowerError(
                f"power has shape {power.shape} and values {power.min():g} to {power.max():g}, "
                f"allowed: {expected} in 0 to 1; make the design for this rig",
                field="power",
            )
        limits.check(power)
        levels = dark(self.needed)
        channel = ["rgb".index(letter) for letter in self.order]
        each = leds_per_fiber(self.colors)
        triples = np.pad(power, [(0, 0), (0, 3 * each - self.colors)]).reshape(-1, each, 3)
        lit = np.array(self.leds)[:, None] * each + np.arange(each)
        levels[lit] = np.rint(FULL_LEVEL * triples)[..., channel].astype(np.uint8)
        return levels


@dataclass(frozen=True)
class PowerLimits:
    """What the rig may draw: nothing is dimmed silently, too much is refused.

    ``total_milliamperes`` is what the supply may give; 500 mA is a USB port.
    """

    total_milliamperes: float = 500.0

    def current(self, power: Array) -> float:
        """Return the current (mA) that ``power`` ``(fiber, color)`` draws."""
        return float(np.sum(power)) * FULL_MILLIAMPERES

    def check(self, power: Array) -> None:
        """Refuse ``power`` ``(fiber, color)`` beyond the limits.

        Raises:
            PowerError: says how much was asked for and how much is allowed.
        """
        current = self.current(power)
        if current > self.total_milliamperes:
            raise PowerError(
                f"the lights would draw {current:.0f} mA, allowed: {self.total_milliamperes:.0f} "
                "mA; lower --scale, or raise --limit-ma if the supply gives more",
                field="current",
            )
