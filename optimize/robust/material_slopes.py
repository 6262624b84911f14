"""The tolerances of a scene, and how transport changes with its material.

A surrogate knows one material. The preview knows any, from its slab response, and its relative
change between neighbors is taken over: ``d log T / d p`` by central differences.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from render.preview import Preview
from render.progress import Clock, OnProgress
from render.scene import Scene, Spread, unchecked

STEP = 0.1
"""Relative step of the differences: the noise of two slab responses, divided by it, stays small."""
MATERIALS = ("sigma_v", "scattering", "diffuser_thickness")
"""Tolerances that change the transport itself."""
PER_FIBER = ("led_power", "fiber_angle", "sigma_v")
"""Tolerances that every fiber has for itself; the others are common to the sensor."""
WORDS = {
    "fiber_angle": ("°", 180.0 / math.pi, "every fiber's angle"),
    "led_power": (" %", 100.0, "every LED's power"),
    "sigma_v": (" %", 100.0, "every beam's width"),
    "camera_gain": (" %", 100.0, "the camera's gain"),
    "scattering": (" %", 100.0, "the diffuser's scattering"),
    "diffuser_thickness": (" mm", 1.0, "the diffuser"),
}
"""Unit, factor from rad, mm or relative errors, and what has the error."""


USUAL = {
    "fiber_angle": Spread("normal", math.radians(5.0), "assumed: usual"),
    "led_power": Spread("normal", 0.05, "assumed: usual"),
    "camera_gain": Spread("normal", 0.02, "assumed: usual"),
    "diffuser_thickness": Spread("normal", 0.06, "assumed: usual"),
}
"""Tolerances of sensors whose scene declares none."""


def tolerances_of(scene: Scene) -> dict[str, Spread]:
    """Return the tolerances of ``scene`` by name: those that it declares, else the `USUAL` ones.

    Of these, angles are those of lamps that turn, and a thickness is that of a diffuser.
    """
    declared = scene.tolerances.spreads() if scene.tolerances else {}
    absent = set() if any(scene.turning) else {"fiber_angle"}
    absent |= set() if scene.diffuser else {"diffuser_thickness"}
    return declared or {name: spread for name, spread in USUAL.items() if name not in absent}


def usual_tolerances_note(scene: Scene) -> list[str]:
    """Return that tolerances are the `USUAL` ones, where the scene declares none."""
    if scene.tolerances and scene.tolerances.spreads():
        return []
    return [
        f"{scene.name} declares no tolerances, so they are the usual ones: "
        f"{'; '.join(spread_words(*entry) for entry in tolerances_of(scene).items())}. State your "
        "own under [tolerances] in its file."
    ]


def spread_words(name: str, spread: Spread) -> str:
    """Return one standard deviation of a tolerance in words.

    >>> spread_words("led_power", USUAL["led_power"])
    "5 % of every LED's power"
    """
    unit, factor, owner = WORDS[name]
    return f"{spread.sigma * factor:.3g}{unit} of {owner}"


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
    """Return ``d log T / d p`` ``(fiber, phi_node, bend, site, facet + 1[, channel])`` by name.

    The untouched pad comes last. Of ``tolerances``, those of the material are looked at; ``phi`` is
    ``(phi_node,)`` rad.
    """
    bends, slopes = np.array(scene.state_axis), {}
    names = [name for name in MATERIALS if name in tolerances]
    clock = Clock(2 * len(names), progress)
    for name in names:
        around = neighbors(scene, name)
        logs = []
        for neighbor in (around.below, around.above):
            with Preview(neighbor) as preview:
                facets, pad = preview.transport(phi, bends)
            transport = np.concatenate([facets, np.expand_dims(pad, 4)], axis=4)
            logs.append(np.log(np.maximum(transport, 1e-12 * transport.max())))
            clock.tick()
        slopes[name] = np.asarray((logs[1] - logs[0]) / (2.0 * around.step))
    return slopes
