"""The calibrated scene as a file: every fitted value says so, with date and interval."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

from hw.calibration.rig_fit import Calibration
from render.scene import scene_text
from tactilux import Scene

SUFFIX = "-calibrated"


def calibrated_toml(source: str | Path, scene: Scene, found: Calibration, date: str) -> str:
    """Return the text of the scene file in ``source`` with the fitted values put in.

    Arguments:
        source: name of a shipped scene or path of a file.
        scene: what it holds.
        found: the calibration.
        date: ISO date, written beside each value.
    """
    raw = tomllib.loads(scene_text(source))
    assert scene.diffuser is not None
    # From fitted values to those of the file.
    per_event = 1 / (1 - scene.diffuser.g)
    keys = (
        ("diffuser", "sigma_s", per_event, "1/mm"),
        ("diffuser", "sigma_a", 1.0, "1/mm"),
        ("fibers", "sigma_v", 180 / math.pi, "deg"),
        ("pad", "roughness", 1.0, ""),
    )
    values = zip(keys, found.material.array().tolist(), found.intervals, strict=True)
    for (part, key, factor, unit), value, (low, high) in values:
        interval = f"{low * factor:.4g} to {high * factor:.4g} {unit}".rstrip()
        entry = raw[part][key]
        entry["value"] = float(f"{value * factor:.6g}")
        entry["source"] = f"calibrated {date}, 95 % interval {interval}"
    raw["pad"]["roughness"]["source"] += "; held near the value before"
    g = raw["diffuser"]["g"]
    g["source"] = (
        f"{str(g['source']).split(';')[0]}; photographs cannot separate g and sigma_s, only "
        "sigma_s (1 - g) is calibrated"
    )
    if not raw["name"].endswith(SUFFIX):
        raw["name"] += SUFFIX
    head = "# Calibrated to photographs by tactilux; powers and gains are in calibration.json.\n"
    return head + _written(raw)


def _written(raw: dict[str, Any]) -> str:
    """Return TOML of plain keys first, then one table per part with one key per line."""
    plain = [f"{key} = {_value(item)}" for key, item in raw.items() if not isinstance(item, dict)]
    parts = [
        "\n".join([f"[{part}]", *(f"{key} = {_value(item)}" for key, item in content.items())])
        for part, content in raw.items()
        if isinstance(content, dict)
    ]
    return "\n\n".join(["\n".join(plain), *parts]) + "\n"


def _value(item: Any) -> str:
    if isinstance(item, dict):
        return "{ " + ", ".join(f"{key} = {_value(part)}" for key, part in item.items()) + " }"
    # Strings, numbers and lists of these are the same in JSON; TOML has no other numbers here.
    return json.dumps(item, ensure_ascii=False)
