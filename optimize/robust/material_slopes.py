"""The tolerances of a scene, and how transport changes with its material.

A surrogate knows one material. The preview knows any, from its slab response, and its relative
change between neighbors is taken over: ``d log T / d p`` by central differences.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from render.errors import SceneError
from render.preview import Preview
from render.progress import Clock, OnProgress
from render.scene import Scene, Spread, unchecked

STEP = 0.1
"""Relative step of the differences: the noise of two slab responses, divided by it, stays small."""
MATERIALS = ("sigma_v", "scattering", "diffuser_thickness")
"""Tolerances that change the transport itself."""
PER_FIBER = ("led_power", "fiber_angle", "sigma_v")
"""Tolerances that every fiber has for itself; the others are common to the sensor."""


def declared_tolerances(scene: Scene) -> dict[str, Spread]:
    """Return the tolerances of ``scene`` by name.

    Raises:
        SceneError: there is none to be robust against.
    """
    spreads = scene.tolerances.spreads() if scene.tolerances else {}
    if not spreads:
        raise SceneError(
            f"scene {scene.name} has no tolerances: add a [tolerances] section to its file, for "
            'example led_power = { distribution = "normal", deviation = 0.05, unit = "relative", '
            'source = "data sheet" }',
            field="tolerances",
        )
    return spreads


@dataclass(frozen=True)
class Neighbors:
    """A parameter of the material and the scenes on both sides of its value.

    ``step`` is half their distance, in the tolerance's own unit (mm, or relative).
    """

    below: Scene
    above: Scene
    step: float


def neighbors(scene: Scene, name: str) -> Neighbors:
    """Return the neighbors of ``scene`` in ``sigma_v``, ``scattering`` or ``diffuser_thickness``.

    Relative parameters step in the logarithm, so that the difference is exact for powers.
    """
    if name == "sigma_v":
        below, above = (scene.with_sigma_v(float(np.exp(sign * STEP))) for sign in (-1, 1))
        return Neighbors(below, above, STEP)
    if scene.diffuser is not None:
        part = "diffuser"
        key = {"scattering": "sigma_s", "diffuser_thickness": "thickness"}[name]
        value = float(getattr(scene.diffuser, key))
    else:
        raise KeyError(name)  # refused when the scene was read
    relative = name != "diffuser_thickness"

    def moved(sign: float) -> Scene:
        new = value * float(np.exp(sign * STEP)) if relative else value * (1.0 + sign * STEP)
        changed = unchecked(getattr(scene, part), {key: new})
        return unchecked(scene, {part: changed})

    return Neighbors(moved(-1.0), moved(1.0), STEP if relative else STEP * value)


def material_slopes(
    scene: Scene,
    tolerances: Collection[str],
    phi: Array,
    progress: OnProgress | None = None,
) -> dict[str, Array]:
    """Return ``d log T / d p`` ``(fiber, phi_node, bend, site, facet[, channel])`` by name.

    Of ``tolerances``, those of the material are looked at; ``phi`` is ``(phi_node,)`` rad.
    """
    bends, slopes = np.array(scene.state_axis), {}
    names = [name for name in MATERIALS if name in tolerances]
    clock = Clock(2 * len(names), progress)
    for name in names:
        around = neighbors(scene, name)
        logs = []
        for neighbor in (around.below, around.above):
            with Preview(neighbor) as preview:
                transport, _ = preview.transport(phi, bends)
            logs.append(np.log(np.maximum(transport, 1e-12 * transport.max())))
            clock.tick()
        slopes[name] = np.asarray((logs[1] - logs[0]) / (2.0 * around.step))
    return slopes
