"""What WLED says it does beside what it was asked to show: each difference, and how to mend it.

Fields are named as in its JSON API: ``state`` and ``info``, ``seg`` the segment that is lit,
``cfg`` its settings. A version without a field lacks what the field tells, unless it is required.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hw.leds.board import Levels
from optimize.design import FULL_MILLIAMPERES

SEGMENT = 0
"""The segment that is lit."""
TOLERANCE = 2
"""Counts by which WLED may err where it computes a level back."""


@dataclass(frozen=True)
class Difference:
    """A ``field`` of WLED's answer: what it ``read``, what is ``allowed``, how to ``mend`` it."""

    field: str
    read: object
    allowed: object
    mend: str

    def __str__(self) -> str:
        """Return it as a clause."""
        return f"{self.field} = {short(self.read)}, allowed: {self.allowed}; {self.mend}"


ONE_SEGMENT = (
    "in WLED's app keep one segment from 0 to the last LED, with grouping 1, spacing 0 and "
    "offset 0, neither reversed nor mirrored"
)
OTHERS = "see what else sets it (a preset, sync, a button, another program) and end that"
PREFERENCES = "switch that off under LED preferences in WLED's settings"
OLD = "update WLED to 0.13 or later"


@dataclass(frozen=True)
class Rule:
    """A field that must be as ``asked``; absent, it counts as that unless it is ``required``."""

    field: str
    asked: object
    mend: str
    required: bool = False

    def difference(self, answer: Mapping[str, Any]) -> Difference | None:
        """Return how ``answer`` differs."""
        value = field_of(answer, self.field)
        if value is None and self.required:
            return Difference(self.field, None, self.asked, OLD)
        # In Python True is 1: a number that stands where a truth value must is a difference.
        same_kind = isinstance(value, bool) == isinstance(self.asked, bool)
        if value is None or (value == self.asked and same_kind):
            return None
        return Difference(self.field, value, self.asked, self.mend)


LIT = (
    Rule("state.on", True, OTHERS, required=True),
    Rule("state.bri", 255, OTHERS, required=True),
    Rule("state.transition", 0, OTHERS),
    Rule("state.nl.on", False, "switch its timer (nightlight) off"),
    Rule("state.pl", -1, "end the playlist in WLED's app"),
    Rule("state.ledmap", 0, "choose the default LED map in WLED's app"),
    Rule("seg.start", 0, ONE_SEGMENT, required=True),
    Rule("seg.grp", 1, ONE_SEGMENT),
    Rule("seg.spc", 0, ONE_SEGMENT),
    Rule("seg.of", 0, ONE_SEGMENT),
    Rule("seg.rev", False, ONE_SEGMENT),
    Rule("seg.mi", False, ONE_SEGMENT),
    Rule("seg.on", True, OTHERS, required=True),
    Rule("seg.frz", True, "end what unfreezes the segment, or update WLED to 0.13 or later", True),
    Rule("seg.bri", 255, OTHERS, required=True),
    Rule("cfg.light.scale-bri", 100, "set the brightness factor to 100 % under LED preferences"),
    Rule("cfg.hw.led.cct", False, f"white balance correction: {PREFERENCES}"),
)
DARK = (Rule("state.on", False, OTHERS, required=True),)


def differences(
    levels: Levels, answer: Mapping[str, Any], settings: Mapping[str, Any]
) -> Iterator[Difference]:
    """Yield how ``answer`` (``state`` and ``info``) differs from ``levels`` ``(led, 3)``.

    ``settings`` are WLED's, empty where it does not tell them.
    """
    seg, others = _segments(answer["state"].get("seg"))
    tree = {**answer, "cfg": settings, "seg": seg}
    lit = bool(levels.any())
    yield from _live(tree)
    if lit and seg is None:
        yield Difference("state.seg", answer["state"].get("seg"), "a segment 0", ONE_SEGMENT)
        return
    for rule in LIT if lit else DARK:
        found = rule.difference(tree)
        if found is not None:
            yield found
    if lit:
        yield from _geometry(len(levels), tree, others)
        yield from _limiter(levels, tree)
        yield from _colors(levels, tree)


def pixel_differences(levels: Levels, pixels: list[object]) -> Iterator[Difference]:
    """Yield which LEDs hold other levels in WLED's memory, ``0xWWRRGGBB`` each."""
    for led, asked in enumerate(levels.tolist()):
        held = pixels[led] if led < len(pixels) else None
        split = list(held.to_bytes(4)) if isinstance(held, int) and 0 <= held < 2**32 else None
        if split is None or any(
            abs(one - other) > TOLERANCE for one, other in zip(split, [0, *asked], strict=True)
        ):
            read = None if split is None else split[1:] + split[:1]
            yield Difference(f"LED {led} (red, green, blue, white)", read, [*asked, 0], GAMMA)


GAMMA = (
    "switch gamma correction for color, automatic white and white balance off under LED "
    "preferences in WLED's settings"
)


def field_of(tree: Mapping[str, Any], path: str) -> Any:
    """Return the value at a path of names with dots between, None where there is none.

    >>> field_of({"state": {"nl": {"on": True}}}, "state.nl.on")
    True
    """
    found: Any = tree
    for name in path.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def short(value: object) -> str:
    """Return what a stranger sent as short text, however long or deep it is.

    >>> short([[[[[[[[]]]]]]]])
    '[[[[[[[...]]]]]]]'
    """
    cut = reprlib.Repr()
    cut.maxstring = cut.maxother = 60
    return cut.repr(value)


def number_at(tree: Mapping[str, Any], path: str) -> float | None:
    """Return the number at a path, None where there is none that WLED could mean."""
    value = field_of(tree, path)
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e6 < value < 1e6:
        return None
    return float(value)


def _segments(found: object) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """Return the segment that is lit, and the others that exist."""
    listed = [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []
    seg = next((one for one in listed if one.get("id", SEGMENT) == SEGMENT), None)
    return seg, [one for one in listed if one is not seg]


def _live(tree: Mapping[str, Any]) -> Iterator[Difference]:
    """Yield that another source drives the LEDs, unless WLED was told to override it."""
    if field_of(tree, "info.live") in (None, False) or number_at(tree, "state.lor"):
        return
    source = " from ".join(str(field_of(tree, f"info.{name}")) for name in ("lm", "lip"))
    mend = "end the program that sends to it, or choose its live override in WLED's app"
    yield Difference("info.live", source, False, mend)


def _geometry(
    needed: int, tree: Mapping[str, Any], others: list[dict[str, Any]]
) -> Iterator[Difference]:
    """Yield a segment that is too short, other segments that shine, and a panel."""
    end = _end(tree["seg"])
    if end is None or end < needed:
        yield Difference("seg.stop", end, f"{needed} or more", ONE_SEGMENT)
    for other in others:
        start = number_at(other, "start")
        if other.get("stop") == 0:  # deleted
            continue
        if other.get("on") is not False or start is None or start < needed:
            yield Difference(
                "state.seg", f"a second segment, {other.get('id')}", "one", ONE_SEGMENT
            )
    if field_of(tree, "info.leds.matrix") is not None:
        yield Difference(
            "info.leds.matrix", field_of(tree, "info.leds.matrix"), "a chain of LEDs",
            "choose a 1D strip under 2D configuration in WLED's settings",
        )  # fmt: skip


def _end(seg: Mapping[str, Any]) -> float | None:
    stop = number_at(seg, "stop")
    start, length = number_at(seg, "start"), number_at(seg, "len")
    return start + length if stop is None and start is not None and length is not None else stop


def _limiter(levels: Levels, tree: Mapping[str, Any]) -> Iterator[Difference]:
    """Yield that the brightness limiter is at its limit.

    Dimmed, WLED says that it draws its limit: exactly since 16, until then less up to two of 255
    steps of brightness. 0.15 does not count what a dark LED draws, 1 mA; nor may 0.16, a version of
    its developers.
    """
    drawn = number_at(tree, "info.leds.pwr") or 0.0
    outputs = _outputs(tree)
    limit = number_at(tree, "info.leds.maxpwr") or math.fsum(
        number_at(output, "maxpwr") or 0.0 for output in outputs
    )
    release = re.match(r"(\d{1,3})\.(\d{1,3})\.", str(field_of(tree, "info.ver")))
    numbers = (0, 15) if release is None else (int(release[1]), int(release[2]))
    below = float(len(outputs))  # what the controller draws is divided among them, in whole mA
    if numbers < (16, 0):
        below = 2 / 255 * float(levels.sum()) / 255 * FULL_MILLIAMPERES
    if (0, 15) <= numbers < (16, 0):
        below += number_at(tree, "info.leds.count") or 0.0
    if limit > 0 and drawn > 0 and drawn >= limit - below:
        mend = (
            "give the limiter the supply's current, or switch it off, under LED preferences in "
            "WLED's settings, or lower --scale"
        )
        yield Difference("info.leds.pwr", drawn, f"below maxpwr = {limit:g} mA", mend)


def _colors(levels: Levels, tree: Mapping[str, Any]) -> Iterator[Difference]:
    """Yield settings by which a color becomes another one."""
    gamma = Rule("cfg.light.gc.col", 1, GAMMA).difference(tree)
    if gamma is not None and not _pure(levels):
        yield gamma
    capable = number_at(tree, "info.leds.lc")
    if capable is not None and not int(capable) & 1:
        yield Difference("info.leds.lc", int(capable), "LEDs with red, green and blue",
                         "choose the LEDs' own type under LED preferences")  # fmt: skip
    if field_of(tree, "info.leds.rgbw") is not True:
        return
    over = number_at(tree, "cfg.hw.led.rgbwm")
    for output in _outputs(tree):
        mode = number_at(output, "rgbwm") if over in (None, 255) else over
        if mode:
            mend = f"automatic white: {PREFERENCES}"
            yield Difference("cfg.hw.led.ins.rgbwm", mode, "0, none", mend)


def _outputs(tree: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return WLED's outputs, as its settings have them."""
    found = field_of(tree, "cfg.hw.led.ins")
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _pure(levels: Levels) -> bool:
    """Return whether all channels are fully on or off, which gamma leaves as they are."""
    return bool(((levels == 0) | (levels == 255)).all())


def unread_of(levels: Levels, version: str, settings: Mapping[str, Any], pixels: bool) -> str:
    """Return what nobody can know of ``levels`` that are shown, "" where all is read back.

    Since WLED 16 gamma comes after the ``pixels`` that it tells.
    """
    if settings or not levels.any():
        return ""
    hidden = ["brightness factor", "white balance", "limits per output"]
    if not _pure(levels) and not (pixels and version.startswith("0.")):
        hidden.append("gamma correction")
    return f"{', '.join(hidden)}, which WLED tells over the network alone and without a PIN"
