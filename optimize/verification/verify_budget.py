"""How many samples a verification can afford in a given time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optimize.design import Array
from render.reference.cost import measure_render_cost, stored_plan
from render.scene.schema import Scene

MIN_SAMPLES = 4
"""Samples per cell, however little time there is."""


@dataclass(frozen=True)
class VerificationPlan:
    """What is rendered, see `affordable_samples`; kept in the folder of the renders."""

    scene_hash: str
    minutes: float
    seeds: int
    designs: int
    samples: int


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
    wanted: dict[str, Any] = {
        "scene_hash": scene.hash,
        "minutes": minutes,
        "seeds": seeds,
        "designs": designs,
    }

    def make() -> VerificationPlan:
        cost = measure_render_cost(scene, phi[:, None])
        renders = [1.0] * (len(scene.bending.angles) * seeds * designs)
        chosen = cost.samples_within(60.0 * minutes, renders, MIN_SAMPLES)
        return VerificationPlan(samples=chosen, **wanted)

    return stored_plan(folder / "plan.json", VerificationPlan, wanted, make).samples
