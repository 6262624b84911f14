"""Previews of shipped sensors as gel on a plate of another index against analog photons.

Those of pads on windows are held in ``tests.validation.test_pad_previews``.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

import numpy as np
import pytest

from render.preview.converged import Effort, transport_at
from render.progress import Clock
from render.scene import Scene
from tests.long import LONG
from tests.oracles.kept_photons import PHI, analog, traced
from tests.validation.deviations import deviation

SCENES = resources.files("render") / "scenes"
PHOTONS, ARRIVALS = (1_000_000, 6_000_000) if LONG else (200_000, 2_000_000)
WHOLE = ("digit 1.49", "digit 1.58", "gelsight-mini 1.49", "gelsight-mini 1.58")
LAMPS = 4
"""So many of a sensor are asked."""


def scene_on_window(case: str) -> Scene:
    """Return a shipped sensor as gel on a plate of an index.

    The gel of digit is 2 mm thick, its plate 6.15 mm and lit at its edges; gelsight-mini has a
    plate of 2 mm, which is lit at its edges at index 1.49 and whose pad is lit at 1.58.
    """
    name, _, index = case.rpartition(" ")
    content: dict[str, Any] = tomllib.loads((SCENES / f"{name}.toml").read_text())
    content["name"] = "on-a-window"
    height, thickness = (-3.0, 6.15) if name == "digit" else (-1.0, 2.0)
    if name == "digit":
        content["pad"]["thickness"]["value"] = 2.0
        content["pad"]["index"]["value"] = 1.41
        for lamp in content["lamps"]:
            lamp["position"]["value"][2] = height
    if name == "digit" or index == "1.49":
        for row in content["rows"]:
            row["height"]["value"] = height
    content["window"] = {
        "thickness": {"value": thickness, "unit": "mm", "source": "assumed"},
        "index": {"value": float(index), "source": "assumed"},
    }
    return Scene.model_validate(content)


@pytest.mark.parametrize("case", WHOLE if LONG else WHOLE[:1])
def test_converged_previews_are_right_through_a_window(case: str) -> None:
    scene, phi, pressed = scene_on_window(case), np.array([PHI]), True
    effort = Effort(paths=8192, arrivals=ARRIVALS)
    found = transport_at(scene, 0.0, phi, effort, Clock(1, None)).cells[:, 0, :, :-1]
    truth = traced(analog(scene, pressed), PHOTONS)
    chosen = np.unique(np.linspace(0, scene.lamp_count - 1, LAMPS).astype(int))
    light = found[chosen].reshape(len(chosen), -1)
    together = deviation(light.sum(axis=0), truth[:, chosen].sum(axis=1))
    assert abs(together.ratio - 1.0) < 3.0 * together.error + 0.02
    assert together.median < together.noise + 0.05
    for row, lamp in zip(light, chosen, strict=True):
        alone = deviation(row, truth[:, lamp])
        assert abs(alone.ratio - 1.0) < 3.5 * alone.error + 0.04
