"""LED colors: what each type of LED adds to each channel of the camera.

A scene that says nothing has the LEDs red, green and blue, each seen by the channel of its name
alone. What a fiber adds to channel c is ``power * response[color, c]`` times its transport.

Pictures that are taken one after the other, shots, are channels of one picture: each shot has its
own. A lamp that shines in some of them alone has a color of its own, such as ``red@1+3``.
"""

from __future__ import annotations

import colorsys
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from render.arrays import Array
from render.scene.quantities import Part, Quantity

OFF = "off"
"""What a fiber without light is called, so no LED may be."""
COLOR_NAME, INK = r"^[a-z][a-z0-9_-]{0,31}$", r"^#[0-9a-f]{6}$"
ColorName = Annotated[str, Field(pattern=COLOR_NAME)]
MAX_CHANNELS, MOST_SHOTS = 16, 4
"""Of one picture, or of all shots of it together; shots of n lamps make 2^n - 1 patterns."""
_INKS = {
    "amber": "#b9770e",
    "violet": "#7d3c98",
    "cyan": "#117a8b",
    "orange": "#a04000",
    "white": "#5d6d7e",
    "yellow": "#6c7a00",
}
"""Of LEDs to which a scene gives no ink: by name, the others in this order. White letters are read
on each."""
_OFF_INK = "#9aa0aa"
_SEEN_AS = {"red": (1.0, 0.0, 0.0), "green": (0.0, 1.0, 0.0), "blue": (0.0, 0.0, 1.0)}


def _shines(name: str) -> str:
    if name == OFF:
        raise ValueError(f"allowed: any other name, {OFF} is a lamp without light")
    return name


class LedColor(Part):
    """A type of LED: its name and what each channel of the camera sees of its light.

    ``response`` is relative: 1 where a channel sees the whole scale of the design's power.
    ``ink`` is what reports draw it with, ``#rrggbb``.
    """

    name: Annotated[ColorName, AfterValidator(_shines)]
    response: Annotated[tuple[float, ...], Quantity("", 0.0, 1.0, many=True)]
    ink: Annotated[str, Field(pattern=INK)] | None = None


@dataclass(frozen=True)
class Palette:
    """All LED colors of a scene.

    Arguments:
        names: of the colors, in their order; color i is ``names[i]``, a dark fiber's is -1. Where
            there are shots, those of all LEDs in all shots, then pattern by pattern.
        response: ``(color, channel)`` in [0, 1].
        channels: names of the camera's channels, shot by shot.
        inks: ``#rrggbb`` per color, for reports.
        shots: pictures that are taken one after the other.
    """

    names: tuple[str, ...]
    response: tuple[tuple[float, ...], ...]
    channels: tuple[str, ...]
    inks: tuple[str, ...] = field(compare=False)
    shots: int = 1

    @property
    def one_shot(self) -> Palette:
        """The LEDs and the channels of one picture."""
        leds, seen = self.led_count, len(self.channels) // self.shots
        response = tuple(row[:seen] for row in self.response[:leds])
        channels = self.channels[:seen]
        if self.shots > 1:
            channels = tuple(name.rsplit("-", 1)[0] for name in channels)
        return Palette(self.names[:leds], response, channels, self.inks[:leds])

    @property
    def led_count(self) -> int:
        """How many types of LED there are, whatever shots they shine in."""
        return len(self.names) // len(shot_patterns(self.shots))

    @property
    def led(self) -> NDArray[np.int64]:
        """The LED of each color, ``(color,)``, a number of `one_shot`'s names."""
        return np.arange(len(self.names)) % self.led_count

    def in_shots(self, drive: Array) -> Array:
        """Return powers ``(shot, fiber, LED)`` of ``drive`` ``(fiber, color)``: each shot's lights.

        >>> palette = palette_of(None, None, 2)
        >>> palette.names[:4], palette.names[-1]
        (('red', 'green', 'blue', 'red@1'), 'blue@2')
        >>> shot = palette.in_shots(np.eye(9)[[0, 3, 8]])
        >>> shot[0].tolist()
        [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        """
        patterns = shot_patterns(self.shots)
        lit = np.array([[shot in pattern for pattern in patterns] for shot in range(self.shots)])
        by_pattern = np.asarray(drive).reshape(len(drive), len(patterns), self.led_count)
        return np.asarray(np.einsum("sp,fpl->sfl", lit.astype(np.float64), by_pattern))

    def shown(self, picture: Array) -> Array:
        """Return linear sRGB ``(row, shots of columns, 3)`` of ``(row, column, channel)``.

        Shots stand side by side, from left to right.
        """
        return np.hstack([part @ self.display for part in np.split(picture, self.shots, axis=-1)])

    @property
    def matrix(self) -> Array:
        """The response ``(color, channel)``, float64."""
        return np.array(self.response)

    @property
    def exchangeable(self) -> bool:
        """Whether exchanging colors only exchanges channels: each has one of its own, alike."""
        seen = self.matrix > 0.0
        alone = (seen.sum(axis=1) == 1).all() and (seen.sum(axis=0) <= 1).all()
        return bool(alone and len(np.unique(self.matrix[seen])) == 1)

    @property
    def one_hue(self) -> bool:
        """Whether all colors look alike but for brightness, so that hue says nothing."""
        return bool(np.linalg.matrix_rank(self.matrix) == 1)

    @property
    def display(self) -> Array:
        """Linear sRGB ``(channel of a shot, 3)`` that pictures show full channels with.

        Together they are white. Red, green and blue are themselves and a lone channel is gray;
        others share the hues.
        """
        channels = self.one_shot.channels
        if len(channels) == 1:
            return np.ones((1, 3))
        if set(channels) <= set(_SEEN_AS):
            return np.array([_SEEN_AS[name] for name in channels])
        hues = np.arange(len(channels)) / len(channels)
        colors = np.array([colorsys.hsv_to_rgb(hue, 1.0, 1.0) for hue in hues])
        return np.asarray(colors / colors.sum(axis=0).max())

    def index(self, name: str) -> int:
        """Return the number of a color, -1 for ``off``."""
        return -1 if name == OFF else self.names.index(name)

    def name(self, index: int) -> str:
        """Return the name of a color, ``off`` for -1."""
        return OFF if index < 0 else self.names[index]

    def ink(self, name: str) -> str:
        """Return what a color, or ``off``, is drawn with."""
        return _OFF_INK if name == OFF else self.inks[self.index(name)]

    def problems(self, *, named: bool = True) -> Iterator[str]:
        """Yield what is wrong with the colors of a scene file, one sentence each.

        ``named`` is whether the file names colors; one that does not has those of `RGB`.
        """
        if self.shots > 1:
            yield from self._shot_problems()
            yield from self.one_shot.problems(named=named)
            return
        for what, names in (("colors", self.names), ("camera.channels", self.channels)):
            for name in sorted({name for name in names if names.count(name) > 1}):
                yield f"{what} name {name} twice, allowed: once"
        if len(self.channels) > MAX_CHANNELS:
            yield f"camera.channels are {len(self.channels)}, allowed: at most {MAX_CHANNELS}"
        seen = ", ".join(self.channels)
        if not named and len(self.channels) != len(DEFAULT_CHANNELS):
            yield (
                f"missing [[colors]]: camera.channels = {seen}, and a scene without [[colors]] has "
                "LEDs red, green and blue of three channels, allowed: [[colors]] whose response "
                f"has {len(self.channels)} value{'s' * (len(self.channels) != 1)}, one per channel"
            )
            return
        for name, response in zip(self.names, self.response, strict=True):
            if len(response) != len(self.channels):
                yield (
                    f"colors.{name}.response has {len(response)} "
                    f"value{'s' * (len(response) != 1)}, allowed: {len(self.channels)}, one per "
                    f"channel ({seen})"
                )
            elif not any(response):
                yield f"colors.{name}.response is all 0, allowed: some channel must see it"

    def _shot_problems(self) -> Iterator[str]:
        """Yield that all shots have more channels together than are served."""
        seen = len(self.channels) // self.shots
        if seen * self.shots > MAX_CHANNELS >= seen:
            most = min(MAX_CHANNELS // seen, MOST_SHOTS)
            yield (
                f"camera.shots = {self.shots} of {seen} channels have {seen * self.shots}, "
                f"allowed: at most {MAX_CHANNELS}, which is camera.shots = {most}"
            )


DEFAULT_CHANNELS = ("red", "green", "blue")
RGB = Palette(
    DEFAULT_CHANNELS,
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    DEFAULT_CHANNELS,
    ("#d1352b", "#1e9e4a", "#2f5fd0"),
)
"""What a scene has that says nothing of colors."""


def palette_of(
    colors: tuple[LedColor, ...] | None, channels: tuple[str, ...] | None, shots: int = 1
) -> Palette:
    """Return the palette of a scene's ``colors`` and its camera's ``channels``; None: as `RGB`.

    With ``shots`` each channel is there once per shot, and each color once per set of shots that
    it may shine in.
    """
    seen = channels or DEFAULT_CHANNELS
    if colors is None:
        return with_shots(Palette(RGB.names, RGB.response, seen, RGB.inks), shots)
    names = tuple(color.name for color in colors)
    known = dict(zip(RGB.names, RGB.inks, strict=True)) | _INKS
    left = [ink for name, ink in _INKS.items() if name not in names]
    spare = itertools.cycle(left or _INKS.values())
    inks = tuple(color.ink or known.get(color.name) or next(spare) for color in colors)
    response = tuple(color.response for color in colors)
    return with_shots(Palette(names, response, seen, inks), shots)


def shot_patterns(shots: int) -> tuple[tuple[int, ...], ...]:
    """Return the sets of shots that a lamp may shine in, counted from 0: all of them first.

    >>> shot_patterns(2)
    ((0, 1), (0,), (1,))
    """
    every = tuple(range(shots))
    some = [chosen for size in range(1, shots) for chosen in itertools.combinations(every, size)]
    return (every, *some)


def shot_names(name: str, shots: int) -> tuple[str, ...]:
    """Return what a color is called in each of `shot_patterns`.

    >>> shot_names("red", 3)
    ('red', 'red@1', 'red@2', 'red@3', 'red@1+2', 'red@1+3', 'red@2+3')
    """
    _, *some = shot_patterns(shots)
    return (name, *(f"{name}@{'+'.join(str(shot + 1) for shot in pattern)}" for pattern in some))


def with_shots(one: Palette, shots: int) -> Palette:
    """Return the palette of so many pictures, each with the channels of ``one``."""
    if shots == 1:
        return one
    patterns = shot_patterns(shots)
    named = [shot_names(name, shots) for name in one.names]
    return Palette(
        names=tuple(names[place] for place in range(len(patterns)) for names in named),
        response=tuple(
            sum((row if shot in pattern else (0.0,) * len(row) for shot in range(shots)), ())
            for pattern in patterns
            for row in one.response
        ),
        channels=tuple(f"{name}-{shot + 1}" for shot in range(shots) for name in one.channels),
        inks=one.inks * len(patterns),
        shots=shots,
    )


def colors_in(raw: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what fibers may be in a scene file that is read but not yet validated."""
    named = raw.get("colors")
    names = RGB.names
    if isinstance(named, list):
        said = [one.get("name") for one in named if isinstance(one, dict)]
        names = tuple(name for name in said if isinstance(name, str) and name != OFF) or names
    camera = raw.get("camera")
    shots = camera.get("shots") if isinstance(camera, dict) else None
    shots = shots.get("value") if isinstance(shots, dict) else shots
    if isinstance(shots, int) and 1 < shots <= MOST_SHOTS:
        names = tuple(name for color in names for name in shot_names(color, shots))
    return names if raw.get("schema") == 1 else (*names, OFF)
