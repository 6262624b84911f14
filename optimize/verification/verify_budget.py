"""How many samples a verification can afford in a given time."""

from __future__ import annotations

from pathlib import Path

from optimize.design import Array
from render.files import read_json, write_json
from render.reference.cost import measure_render_cost
from render.scene.schema import Scene

MIN_SAMPLES = 4
"""Samples per cell, however little time there is."""


def affordable_samples(
    scene: Scene, phi: Array, *, minutes: float, seeds: int, designs: int, folder: Path
) -> int:
    """Return the samples per cell and seed that fill ``minutes``, at least MIN_SAMPLES.

    The choice is kept in ``folder``, so that a verification that was interrupted goes on with
    the same number instead of measuring again.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad, for the trial renders.
        minutes: rendering time for everything together.
        seeds: independent renders per bend and design.
        designs: how many are rendered, 1 when the other differs in colors alone.
        folder: of the checkpoint.
    """
    path = folder / "plan.json"
    plan = {"scene_hash": scene.hash, "minutes": minutes, "seeds": seeds, "designs": designs}
    known = read_json(path)
    if all(known.get(key) == value for key, value in plan.items()) and "samples" in known:
        return int(str(known["samples"]))
    cost = measure_render_cost(scene, phi[:, None])
    renders = len(scene.bending.angles) * seeds * designs
    samples = max(MIN_SAMPLES, cost.samples_within(60.0 * minutes, [1.0] * renders))
    write_json(path, {**plan, "samples": samples})
    return samples
