"""Random sensors of the family that a scene file describes, drawn from a seed.

``python -m tests.oracles.random_scenes 20 FOLDER`` writes the first twenty as scene files, which
``tactilux frontier FOLDER`` takes.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from render.scene import Scene

TRIES = 200


def random_scene(seed: int) -> Scene:
    """Return the sensor number ``seed``: size, thickness, material, lamps, camera and bends drawn.

    The camera looks at all sites; half the sensors have a diffuser, a third bend. Drawn again
    until all parts fit together.
    """
    return Scene.model_validate(random_content(seed))


def with_beams(seed: int, width: float) -> Scene:
    """Return the sensor number ``seed``, of fibers, with beams of ``width`` deg."""
    content = random_content(seed)
    content["fibers"]["sigma_v"]["value"] = width  # type: ignore[index]
    return Scene.model_validate(content)


def random_content(seed: int) -> dict[str, object]:
    """Return what a scene file of the sensor number ``seed`` holds."""
    rng = np.random.default_rng([2026, seed])
    for _ in range(TRIES):
        content = _draw(rng, seed)
        try:
            Scene.model_validate(content)
        except ValueError:
            continue
        return content
    raise AssertionError(f"no scene fits together for seed {seed}")


def _draw(rng: np.random.Generator, seed: int) -> dict[str, object]:
    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    def value(number: float, unit: str = "") -> dict[str, object]:
        about: dict[str, object] = {"value": round(number, 4), "source": "drawn"}
        return about | ({"unit": unit} if unit else {})

    width, length, thickness = between(10, 40), between(12, 60), between(2, 10)
    diameter = between(0.3, 2.0)
    radius = between(0.3, 0.9)
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(2, 6))
    spacing = 0.6 * min(width / columns, length / rows)
    distance = between(10, 50)
    reach = 0.5 * spacing * max(columns, rows) + radius
    view = math.degrees(2 * math.atan(1.3 * reach / (distance + thickness / 1.4)))
    scene: dict[str, object] = {
        "schema": 1,
        "name": f"random-{seed}",
        "pad": {
            "width": value(width, "mm"),
            "length": value(length, "mm"),
            "thickness": value(thickness, "mm"),
            "index": value(rng.uniform(1.4, 1.55)),
            "roughness": value(between(0.02, 0.3)),
        },
        "coating": {"albedo": value(rng.uniform(0.3, 0.9))},
        "fibers": {
            "left": int(rng.integers(2, 7)),
            "tip": int(rng.integers(2, 7)),
            "right": int(rng.integers(2, 7)),
            "diameter": value(diameter, "mm"),
            "gap": value(diameter * rng.uniform(0.55, 1.5), "mm"),
            "height": value(thickness * rng.uniform(0.25, 0.75), "mm"),
            "sigma_v": value(between(8, 60), "deg"),
            "tilt": value(rng.uniform(-10, 15), "deg"),
        },
        "camera": {
            "distance": value(distance, "mm"),
            "y": value(0.0, "mm"),
            "field_of_view": value(view, "deg"),
            "columns": 400,
            "rows": 400,
        },
        "bending": {
            "angles": {
                "value": [0.0, 30.0, 60.0] if rng.random() < 1 / 3 else [0.0],
                "unit": "deg",
                "source": "drawn",
            }
        },
        "sites": {
            "columns": columns,
            "rows": rows,
            "spacing": value(spacing, "mm"),
            "centre_x": value(0.0, "mm"),
            "centre_y": value(0.0, "mm"),
        },
        "indenter": {
            "faces": int(rng.integers(5, 11)),
            "slope": value(rng.uniform(15, 45), "deg"),
            "radius": value(radius, "mm"),
        },
        "baseline": {"left": "red", "tip": "green", "right": "blue"},
    }
    if rng.random() < 0.5:
        g = rng.uniform(0.3, 0.9)
        scene["diffuser"] = {
            "thickness": value(between(0.5, 4.0), "mm"),
            "sigma_s": value(between(0.2, 2.0) / (1 - g), "1/mm"),
            "sigma_a": value(between(0.001, 0.1), "1/mm"),
            "g": value(g),
        }
    return scene


def scene_text(content: dict[str, object]) -> str:
    """Return ``content`` as TOML: tables of plain values and of ``{value, unit, source}``."""

    def said(value: object) -> str:
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{key} = {said(part)}" for key, part in value.items()) + " }"
        return json.dumps(value)  # Numbers, texts and lists are written alike.

    tables = {key: part for key, part in content.items() if isinstance(part, dict)}
    lines = [f"{key} = {said(part)}" for key, part in content.items() if key not in tables]
    for key, table in tables.items():
        lines += ["", f"[{key}]", *(f"{name} = {said(part)}" for name, part in table.items())]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the first so many sensors as scene files into a folder."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("folder", type=Path)
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, asked.count + 1):
        text = scene_text(random_content(seed))
        (asked.folder / f"random-{seed}.toml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
