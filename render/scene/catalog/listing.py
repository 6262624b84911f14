"""Lists of parts: as rows for a terminal, as plain content for programs, and as a page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from render.scene.catalog.led import Led, LedEntry, entries_of
from render.scene.catalog.photometry import PHOSPHOR_NM

HEADINGS = ("part", "body, mm", "half angle", "nm", "data sheet", "mW", "mA", "PWM, Hz", "USD")
UNITS = {"mcd": "mcd", "lm": "lm", "mw_per_sr": "mW/sr", "mw": "mW"}
PAGE = """# Parts

LEDs that lamps may be: `tactilux explore SCENE --parts red-0603,blue-0603`, or `parts` in \
[`[search]`](scenes.md#which-part-each-lamp-is). A part with several colors is one lamp that \
lights one of them. This page is written by `tactilux parts --out docs/parts.md` from \
`render/scene/catalog/leds.toml`, where sources stand beside the numbers.

"""


def rows_of(leds: Mapping[str, Led]) -> list[tuple[str, ...]]:
    """Return a row under `HEADINGS` for all that lamps may be of ``leds``."""
    return [_row(entry) for led in leds.values() for entry in entries_of(led)]


def content_of(leds: Mapping[str, Led]) -> list[dict[str, Any]]:
    """Return what programs rely on: a table for each entry, with the LED's keys and the die's."""
    return [
        {"entry": entry.name, "part": entry.led.name}
        | entry.led.model_dump(mode="json", exclude={"dies", "name"}, exclude_defaults=True)
        | entry.die.model_dump(mode="json", exclude={"name"}, exclude_defaults=True)
        | {"milliwatts": round(_milliwatts(entry), 6)}
        for led in leds.values()
        for entry in entries_of(led)
    ]


def page_of(leds: Mapping[str, Led]) -> str:
    """Return the page of ``leds``: a table, then their data sheets."""
    lines = [
        "| " + " | ".join(HEADINGS) + " |",
        "|---|---|" + "---:|" * (len(HEADINGS) - 2),
        *("| " + " | ".join(row) + " |" for row in rows_of(leds)),
        "",
        "## Data sheets",
        "",
        *(f"- `{led.name}`: {led.source}" for led in leds.values()),
    ]
    return PAGE + "\n".join(lines) + "\n"


def _row(entry: LedEntry) -> tuple[str, ...]:
    led, die = entry.led, entry.die
    key, said = next((key, getattr(die, key)) for key in UNITS if getattr(die, key) is not None)
    return (
        entry.name,
        " x ".join(f"{side:g}" for side in led.body_mm),
        f"{led.half_angle_deg:g}°",
        "" if die.nm is None else f"{die.nm:g}" + f" + {PHOSPHOR_NM:g}" * die.phosphor,
        f"{said:g} {UNITS[key]}",
        f"{_milliwatts(entry):.2g}",
        f"{die.ma:g}",
        "" if led.pwm_hz is None else f"{led.pwm_hz:g}",
        "" if led.usd is None else f"{led.usd:.2f}",
    )


def _milliwatts(entry: LedEntry) -> float:
    return entry.die.milliwatts(math.radians(entry.led.half_angle_deg))
