"""Previews of pads on a window of another index against analog photons, lamp by lamp and together.

From the command line, with full effort:
``python -m tests.validation.test_window_previews [--arrivals N] [CASE ...]``.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

import numpy as np
import pytest

from render.preview import Preview
from render.preview.converged import Effort, transport_at
from render.progress import Clock
from render.scene import Scene
from tests.long import LONG
from tests.oracles.kept_photons import PHI, analog, photons_kept, traced
from tests.oracles.pads import scene_of_case
from tests.validation.deviations import (
    Deviation,
    assert_converged_is_near,
    deviations_of_lamps,
    print_deviations,
)

SCENES = resources.files("render") / "scenes"
PHOTONS = 1_000_000
"""Of each lamp of a shipped sensor on a plate; those of pads are kept."""
ARRIVALS = 6_000_000 if LONG else 2_000_000
FAST = ("window lit at its edges rough 0.05",)
PADS = ("digit 1.49", "digit 1.58", "gelsight-mini 1.49", "gelsight-mini 1.58")
WHOLE = (*FAST, "window", "window lit from below", "window of low index", *PADS)


def scene_on_window(case: str) -> Scene:
    """Return a case of ``tests.oracles.pads``, or a shipped sensor as gel on a plate of an index.

    The gel of digit is 2 mm thick, its plate 6.15 mm and lit at its edges; gelsight-mini has a
    plate of 2 mm, which is lit at its edges at index 1.49 and whose pad is lit at 1.58.
    """
    name, _, index = case.rpartition(" ")
    if name not in ("digit", "gelsight-mini"):
        return scene_of_case(case)
    content: dict[str, Any] = tomllib.loads((SCENES / f"{name}.toml").read_text())
    content["name"] = "on-a-window"
    height, thickness = (-3.0, 6.15) if name == "digit" else (-1.0, 2.0)
    if name == "digit":
        content["pad"]["thickness"]["value"] = 2.0
        content["pad"]["index"]["value"] = 1.41
    if name == "digit" or index == "1.49":
        for row in content["rows"]:
            row["height"]["value"] = height
    content["window"] = {
        "thickness": {"value": thickness, "unit": "mm", "source": "assumed"},
        "index": {"value": float(index), "source": "assumed"},
    }
    return Scene.model_validate(content)


def deviations(case: str, arrivals: int = ARRIVALS, lamps: int = 4) -> dict[str, list[Deviation]]:
    """Return, of the converged preview and the shader's, those of facets.

    Of some lamps, each alone, and last of all of these together.
    """
    scene, phi = scene_on_window(case), np.array([PHI])
    effort = Effort(paths=8192, arrivals=arrivals)
    with Preview(scene) as preview:
        drawn = preview.transport(phi, np.zeros(1))[0][:, 0, 0]
    found = transport_at(scene, 0.0, phi, effort, Clock(1, None)).cells[:, 0, :, :-1]
    chosen = np.unique(np.linspace(0, scene.lamp_count - 1, lamps).astype(int))
    pressed = True
    truth = traced(analog(scene, pressed), PHOTONS) if case in PADS else photons_kept(case, pressed)
    levels = {"converged": list(found[chosen]), "as drawn": list(drawn[chosen])}
    return deviations_of_lamps(levels, [truth[:, lamp] for lamp in chosen])


@pytest.mark.parametrize("case", WHOLE if LONG else FAST)
def test_converged_previews_are_right_through_a_window(case: str) -> None:
    assert_converged_is_near(deviations(case)["converged"])


if __name__ == "__main__":
    print_deviations(WHOLE, deviations, ARRIVALS)
