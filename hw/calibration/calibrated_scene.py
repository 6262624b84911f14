"""The calibrated scene as a file: every fitted value says so, with date and interval."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

from hw.calibration.fit import Calibration
from render.files import write_text
from render.scene.schema import Scene, load_scene, scene_text

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
    ranges = found.intervals.of(found.material.array())
    per_event = 1 / (1 - scene.diffuser.g)
    degrees = 180 / math.pi
    values = {
        ("diffuser", "sigma_s"): (found.material.reduced_scattering, ranges[0], per_event, "1/mm"),
        ("diffuser", "sigma_a"): (found.material.absorption, ranges[1], 1.0, "1/mm"),
        ("fibers", "sigma_v"): (found.material.sigma_v, ranges[2], degrees, "deg"),
        ("pad", "roughness"): (found.material.roughness, ranges[3], 1.0, ""),
    }
    for (part, key), (value, (low, high), factor, unit) in values.items():
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


def save_scene(path: Path, text: str) -> Scene:
    """Write the scene file and return what it holds, read back."""
    write_text(path, text)
    return load_scene(path)


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
