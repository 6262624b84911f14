"""How transport changes with the material: the preview of neighboring materials.

A surrogate knows one material. The preview knows any, from its slab response, and its relative
change between neighbors is taken over: ``d log T / d p`` by central differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from render.preview import Preview
from render.progress import Clock, OnProgress
from render.scene import Scene

STEP = 0.1
"""Relative step of the differences: the noise of two slab responses, divided by it, stays small."""
MATERIALS = ("sigma_v", "scattering", "diffuser_thickness")
"""Tolerances that change the transport itself."""
PER_FIBER = ("led_power", "fiber_angle", "sigma_v")
"""Tolerances that every fiber has for itself; the others are common to the sensor."""


@dataclass(frozen=True)
class Neighbors:
    """A parameter of the material and the scenes on both sides of its value.

    Arguments:
        name: of the tolerance.
        below, above: scenes.
        step: half the distance between them, in the tolerance's own unit (mm, or relative).
    """

    name: str
    below: Scene
    above: Scene
    step: float


def neighbors(scene: Scene, name: str) -> Neighbors:
    """Return the neighbors of ``scene`` in ``sigma_v``, ``scattering`` or ``diffuser_thickness``.

    Relative parameters step in the logarithm, so that the difference is exact for powers.
    """
    if name == "sigma_v":
        part, key, value = "fibers", "sigma_v", scene.fibers.sigma_v
    elif scene.diffuser is not None:
        part = "diffuser"
        key = {"scattering": "sigma_s", "diffuser_thickness": "thickness"}[name]
        value = float(getattr(scene.diffuser, key))
    else:
        raise KeyError(name)  # refused when the scene was read
    relative = name != "diffuser_thickness"

    def moved(sign: float) -> Scene:
        new = value * float(np.exp(sign * STEP)) if relative else value * (1.0 + sign * STEP)
        changed = getattr(scene, part).model_copy(update={key: new})
        return scene.model_copy(update={part: changed})

    return Neighbors(name, moved(-1.0), moved(1.0), STEP if relative else STEP * value)


def material_slopes(
    scene: Scene,
    names: list[str],
    phi: Array,
    progress: OnProgress | None = None,
) -> dict[str, Array]:
    """Return ``d log T / d p`` ``(fiber, phi_node, bend, site, facet)`` by name.

    Arguments:
        scene: the sensor.
        names: of tolerances of the material.
        phi: ``(phi_node,)`` rad.
        progress: told of every preview that is drawn.
    """
    bends, slopes = np.array(scene.bending.angles), {}
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
