"""LEDs as data sheets have them: the shipped ones, and those that a scene file adds.

A number has its unit in its key; all numbers of an LED have one source.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from render.arrays import Array
from render.files import parse_toml
from render.refused_values import did_you_mean
from render.scene.catalog.photometry import (
    BANDS,
    band,
    cosine_exponent,
    flux,
    lumens_per_watt,
    spectrum,
)
from render.scene.colors import ColorName, Palette
from render.scene.lamp_profile import Profile
from render.scene.quantities import Part, allowed_range, check_range

LONGEST_NAME = 32
"""Letters of a color's name."""
LEAST_SEEN = 1e-3
"""Of the light of a die: a channel that sees less of it does not see it."""
POWERS = ("mcd", "lm", "mw_per_sr", "mw")
"""Keys by which a die says how bright it is: one of them."""


@dataclass(frozen=True)
class Number:
    """Annotation of a plain number in ``[low, high]`` whose key names its unit."""

    low: float
    high: float

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return the validation schema."""
        return core_schema.no_info_after_validator_function(
            self._within, core_schema.float_schema(strict=True)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the number."""
        return {
            "type": "number",
            "minimum": self.low,
            "maximum": self.high,
            "description": f"Allowed: {allowed_range(self.low, self.high, '')}.",
        }

    def _within(self, value: float) -> float:
        check_range(value, self.low, self.high, "")
        return value


Bright = Annotated[float, Number(1e-6, 1e6)]
Milliamperes = Annotated[float, Number(0.01, 10_000.0)]
Millimeters = Annotated[float, Number(0.05, 50.0)]


class Die(Part):
    """One color of an LED, as bright as it is at a current.

    ``name`` is what it is called beside others of the LED. ``nm`` is its dominant wavelength and
    ``width_nm`` its full width at half maximum; with ``phosphor`` it is the blue of a white LED. In
    place of ``nm`` a ``response`` may say what each channel of the scene's camera sees of it, 0 to
    1. It has ``mcd`` or ``mw_per_sr`` on its axis, or ``lm`` or ``mw`` in all, at ``ma``
    milliamperes, which are what it draws; ``max_ma`` is what it bears, ``volts`` what it takes.
    """

    name: ColorName | None = None
    nm: Annotated[float, Number(380.0, 1040.0)] | None = None
    width_nm: Annotated[float, Number(1.0, 200.0)] = 25.0
    phosphor: bool = False
    response: Annotated[tuple[Annotated[float, Number(0.0, 1.0)], ...], Field(strict=False)] = ()
    mcd: Bright | None = None
    lm: Bright | None = None
    mw_per_sr: Bright | None = None
    mw: Bright | None = None
    ma: Milliamperes
    max_ma: Milliamperes | None = None
    volts: Annotated[float, Number(0.5, 100.0)] | None = None

    def milliwatts(self, half_angle: float) -> float:
        """Return the radiant power of the beam that falls to a half at ``half_angle`` rad."""
        if self.mw is not None:
            return self.mw
        if self.mw_per_sr is not None:
            return flux(self.mw_per_sr, half_angle)
        lumens = self.lm if self.lm is not None else flux((self.mcd or 0.0) * 1e-3, half_angle)
        return 1e3 * lumens / lumens_per_watt(self._spectrum)

    def seen_by(self, channels: Sequence[str]) -> Array:
        """Return what each of ``channels`` sees of the die's light."""
        if self.response:
            return np.array(self.response)
        bands = [band(channel) for channel in channels]
        return np.array([0.0 if one is None else float(self._spectrum @ one) for one in bands])

    @property
    def _spectrum(self) -> Array:
        return spectrum(self.nm or 0.0, self.width_nm, phosphor=self.phosphor)

    def problems(self, key: str) -> Iterator[str]:
        """Yield what is wrong with the die by itself."""
        said = [name for name in POWERS if getattr(self, name) is not None]
        if len(said) != 1:
            yield f"{key} names {' and '.join(said) or 'no power'}, allowed: {_one_of(POWERS)}"
        if bool(self.response) == (self.nm is not None):
            yield f"{key}: allowed: nm or response, one of them"
        elif self.response and (said == ["mcd"] or said == ["lm"]):
            yield f"{key}.{said[0]}: only of light whose nm is known, allowed: mw or mw_per_sr"
        if self.max_ma is not None and self.ma > self.max_ma:
            yield f"{key}.ma = {self.ma:g}, allowed: at most its max_ma = {self.max_ma:g}"


class Led(Part):
    """An LED, or a fiber on one, that lamps may be.

    ``source`` is its data sheet and revision. ``body_mm`` is its width along the edge and its
    height; ``emits_mm`` the diameter of what shines, or else that of a circle of the body's area.
    The intensity of its beam falls to a half at ``half_angle_deg`` from the axis. ``dies`` are its
    colors, of which a lamp lights one. ``pwm_hz`` is the frequency at which it dims, ``usd`` what
    it costs in US dollars.
    """

    name: ColorName
    source: Annotated[str, Field(pattern=r"\S")]
    body_mm: Annotated[tuple[Millimeters, ...], Field(strict=False, min_length=2, max_length=2)]
    emits_mm: Millimeters | None = None
    half_angle_deg: Annotated[float, Number(1.0, 85.0)]
    dies: Annotated[tuple[Die, ...], Field(strict=False, min_length=1, max_length=8)]
    pwm_hz: Annotated[float, Number(1.0, 1e6)] | None = None
    usd: Annotated[float, Number(0.0, 10_000.0)] | None = None

    @property
    def diameter(self) -> float:
        """Diameter of what shines, mm."""
        if self.emits_mm is not None:
            return self.emits_mm
        return round(math.sqrt(4.0 / math.pi * self.body_mm[0] * self.body_mm[1]), 3)

    @property
    def exponent(self) -> float:
        """Exponent of the cosine that a lamp's beam has; a wider beam counts as Lambertian."""
        return max(round(cosine_exponent(math.radians(self.half_angle_deg)), 6), 1.0)

    @property
    def body(self) -> tuple[float, float]:
        """Diameter and exponent: what decides how a lamp's light spreads."""
        return self.diameter, self.exponent

    def is_body_of(self, diameter: float, profile: Profile) -> bool:
        """Return whether a lamp's light spreads as the LED's does."""
        own = profile.cosine_exponent
        return own is not None and bool(np.allclose((diameter, own), self.body, rtol=1e-6))

    def problems(self, key: str) -> Iterator[str]:
        """Yield what is wrong with the LED by itself."""
        for number, die in enumerate(self.dies):
            yield from die.problems(f"{key}.dies.{number}")
        names = [die.name for die in self.dies]
        if len(self.dies) > 1 and (None in names or len(set(names)) < len(names)):
            yield f"{key}.dies: several, allowed: a name for each, no two alike"
        for entry in entries_of(self):
            if len(entry.name) > LONGEST_NAME:
                yield (
                    f"{key}: {entry.name} is too long a name, allowed: {LONGEST_NAME} letters, the "
                    "LED's, a dash and the die's together"
                )


@dataclass(frozen=True)
class LedEntry:
    """What a lamp may be: one die of an LED, under the ``name`` that colors have of it."""

    name: str
    led: Led
    die: Die


def entries_of(led: Led) -> tuple[LedEntry, ...]:
    """Return what a lamp may be of an LED: the LED itself, or each of its colors.

    >>> [entry.name for entry in entries_of(shipped_leds()["ws2812b"])]
    ['ws2812b-red', 'ws2812b-green', 'ws2812b-blue']
    """
    if len(led.dies) == 1:
        return (LedEntry(led.name, led, led.dies[0]),)
    return tuple(LedEntry(f"{led.name}-{die.name}", led, die) for die in led.dies)


@functools.cache
def shipped_leds() -> Mapping[str, Led]:
    """Return the LEDs of the library by name, in its order."""
    text = (resources.files("render") / "scene" / "catalog" / "leds.toml").read_text("utf-8")
    leds = [Led.model_validate(raw) for raw in parse_toml(text)["leds"]]
    return MappingProxyType({led.name: led for led in leds})


def known_leds(own: Sequence[Led]) -> dict[str, Led]:
    """Return the LEDs that a scene may name, its ``own`` first."""
    return {led.name: led for led in own} | {
        name: led for name, led in shipped_leds().items() if name not in {one.name for one in own}
    }


def known_entries(own: Sequence[Led]) -> dict[str, LedEntry]:
    """Return all that lamps may be, by the names that colors have of it."""
    return {one.name: one for led in known_leds(own).values() for one in entries_of(led)}


def responses(entries: Sequence[LedEntry], channels: Sequence[str]) -> Array:
    """Return what each of ``channels`` sees of each entry at its current, ``(entry, channel)``.

    Relative: 1 is the most that any sees of any.
    """
    seen = np.array(
        [
            one.die.milliwatts(math.radians(one.led.half_angle_deg)) * one.die.seen_by(channels)
            for one in entries
        ]
    )
    return np.asarray(seen / seen.max())


def own_problems(own: Sequence[Led]) -> Iterator[str]:
    """Yield what is wrong with the LEDs that a scene file adds, one sentence each."""
    names = [led.name for led in own]
    for number, led in enumerate(own):
        yield from led.problems(f"parts.{number}")
        if names.count(led.name) > 1 and number == names.index(led.name):
            yield f"parts name {led.name} twice, allowed: once"


def naming_problems(
    named: Sequence[str], own: Sequence[Led], channels: Sequence[str], key: str
) -> Iterator[str]:
    """Yield why a search cannot take the LEDs that are ``named``, one sentence each."""
    known = known_leds(own)
    for name in dict.fromkeys(named):
        if name not in known:
            said = name or '""'
            yield f"{key} = {said}, allowed: {', '.join(known)}{did_you_mean(name, list(known))}"
            continue
        if named.count(name) > 1:
            yield f"{key} names {name} twice, allowed: once"
        for die in known[name].dies:
            unknown = [one for one in channels if band(one) is None]
            if die.response and len(die.response) != len(channels):
                yield (
                    f"{key}: {name} has a response of {len(die.response)} values, allowed: "
                    f"{len(channels)}, one per channel ({', '.join(channels)})"
                )
                break
            if not die.response and unknown:
                yield (
                    f"{key}: what the channel {unknown[0]} sees of {name} is not known, allowed: "
                    f"camera.channels of {', '.join(BANDS)}, or [[parts]] with a response"
                )
                break
            if die.seen_by(channels).max() < LEAST_SEEN:
                yield f"{key}: no channel of the camera sees {name}, allowed: one that some sees"
                break


def entries_in(palette: Palette, own: Sequence[Led]) -> tuple[LedEntry | None, ...]:
    """Return for every color of a palette the entry whose name it bears; None: of no LED."""
    known = known_entries(own)
    return tuple(known.get(name) for name in palette.names)


def _one_of(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"
