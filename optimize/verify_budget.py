"""How many mutations a verification can afford in a given time."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from optimize.atomic import write_text
from optimize.design import Array
from render.reference import render_transport
from render.scene import Scene

TRIALS = (4, 32)
"""Mutations of two short renders at one bend; their difference is free of compiling."""


def affordable_mutations(
    scene: Scene, phi: Array, *, minutes: float, seeds: int, designs: int, folder: Path
) -> int:
    """Return the mutations per cell and seed that fill ``minutes``, at least the smaller trial.

    The choice is kept in ``folder``, so that a verification that was interrupted goes on with
    the same number instead of measuring again.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad, for the trial renders.
        minutes: rendering time for everything together.
        seeds: independent renders per bend and design.
        designs: how many are rendered, 1 when the other differs in colours alone.
        folder: of the checkpoint.
    """
    path = folder / "plan.json"
    plan = {"scene_hash": scene.hash, "minutes": minutes, "seeds": seeds, "designs": designs}
    known = _read(path)
    if all(known.get(key) == value for key, value in plan.items()) and "mutations" in known:
        return int(str(known["mutations"]))
    spent = []
    for trial in TRIALS:
        began = time.monotonic()
        render_transport(
            scene, phi[:, None], np.array(scene.bending.angles[:1]), mutations=trial, seeds=[0]
        )
        spent.append(time.monotonic() - began)
    few, many = TRIALS
    slope = max(spent[1] - spent[0], 1e-3) / (many - few)
    fixed = max(spent[0] - few * slope, 0.0)
    share = (60.0 * minutes - sum(spent)) / (len(scene.bending.angles) * seeds * designs)
    mutations = max(few, int((share - fixed) / slope))
    write_text(path, json.dumps({**plan, "mutations": mutations}) + "\n")
    return mutations


def _read(path: Path) -> dict[str, object]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
