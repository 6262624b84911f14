"""Pads drawn from a seed: flat ones of fibers, and ones that mix all that a scene may name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.oracles.pad_parts import DEG, LAMBERTIAN, MM, lobe, painted, rough, row

EDGES = ("left", "tip", "right", "base")


def log_uniform(rng: np.random.Generator) -> Callable[[float, float], float]:
    """Return what draws a number whose logarithm is uniform between two."""
    return lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_case(number: int) -> dict[str, Any]:
    """Return the changes of the case ``random NUMBER``: anywhere in the ranges of flat pads."""
    rng = np.random.Generator(np.random.PCG64(number))
    between = log_uniform(rng)
    diameter, thickness = between(0.1, 3.0), rng.uniform(2.0, 8.0)
    changes: dict[str, Any] = {
        "pad.roughness": (float(rng.choice([0.0, 0.004, 0.01, 0.03, 0.1, 0.3])),),
        "pad.index": (float(rng.choice([1.0, 1.2, 1.41, 1.7])),),
        "pad.thickness": (thickness, MM),
        "coating.albedo": (rng.uniform(0.2, 0.9),),
        "fibers.diameter": (diameter, MM),
        "fibers.gap": (between(max(0.05, 0.51 * diameter), 10.0), MM),
        "fibers.height": (max(0.0, rng.uniform(-0.3, 1.0)) * thickness, MM),
        "fibers.sigma_v": (between(1.0, 89.0), DEG),
        "fibers.tilt": (rng.uniform(-20.0, 40.0), DEG),
    }
    if rng.random() < 0.3:
        changes["diffuser"] = {
            "thickness": (between(0.3, 3.0), MM),
            "sigma_s": (float(rng.choice([0.0, between(0.05, 20.0)])), "1/mm"),
            "sigma_a": (between(0.001, 0.3), "1/mm"),
            "g": (rng.uniform(-0.3, 0.9),),
        }
    return changes


def mixed_case(number: int) -> dict[str, Any]:
    """Return the changes of the case ``mixed NUMBER``: any concepts of a scene beside each other.

    A skin that is flat, a dome or an arch, with a lobe or without; a window or a diffuser on some
    edges; faces rough, smooth, black, white and mirrors; lamps before and in any edge, below and in
    the silicone, of any profile. A lamp is alone on its edge.
    """
    rng = np.random.default_rng([77, number])
    between = log_uniform(rng)
    thickness, skin = rng.uniform(2.5, 8.0), str(rng.choice(["flat", "flat", "dome", "arch"]))
    changes: dict[str, Any] = {
        "pad.thickness": (thickness if skin == "flat" else max(thickness, 6.0), MM),
        "pad.roughness": (_roughness(rng),),
        "pad.index": (float(rng.choice([1.0, 1.2, 1.41, 1.55, 1.7])),),
        "coating.albedo": (rng.uniform(0.1, 0.65),),
    }
    if rng.random() < 0.3:
        changes |= lobe(rng.uniform(0.05, 0.35), rng.uniform(0.1, 0.5))
    plate, rim = 0.0, []
    if skin != "flat":
        changes["skin"] = {"shape": skin, "radius": (rng.uniform(25.0, 60.0), MM)}
        if skin == "arch":
            changes["skin"]["axis"] = str(rng.choice(["x", "y"]))
    elif rng.random() < 0.3:
        plate = rng.uniform(0.5, 5.0)
        changes["pad.index"] = (float(rng.choice([1.2, 1.41, 1.55, 1.7])),)
        changes["window"] = {"thickness": (plate, MM), "index": (rng.uniform(1.3, 1.8),)}
    elif rng.random() < 0.4:
        rim = [edge for edge in EDGES if rng.random() < 0.5] or ["left"]
        changes["diffuser"] = {"on": rim, **_milk(rng)}
    faces = {edge: _face(edge, rng) for edge in EDGES if edge not in rim}
    changes["faces"] = [entry for entry in faces.values() if entry]
    shut = [edge for edge, entry in faces.items() if entry and "roughness" not in entry]
    changes["rows"] = []
    for edge in EDGES:
        if rng.random() < 0.5:
            continue
        inside = edge in shut or (edge not in rim and rng.random() < 0.2)
        if inside:
            diameter, height = between(0.2, 1.2), rng.uniform(0.8, 1.4)
            gap = -0.3 - 0.6 * diameter
        else:
            diameter, height = between(0.2, 2.5), rng.uniform(0.15, 0.85) * min(thickness, 3.5)
            gap = between(max(0.05, 0.55 * diameter), 6.0)
            if plate and rng.random() < 0.3:
                height = -rng.uniform(0.1, 0.9) * plate
        changes["rows"].append(
            row(
                edge, 1, diameter=diameter, gap=gap, height=height, tilt=rng.uniform(-20.0, 30.0),
                profile=_profile(rng), turns=not inside and rng.random() < 0.5,
            )
        )  # fmt: skip
    if not changes["rows"]:
        del changes["rows"]
        changes["lamps"] = [_listed(rng, plate)]
    return changes


def _roughness(rng: np.random.Generator) -> float:
    return float(rng.choice([0.0, 0.0, 0.03, 0.1, 0.3]))


def _milk(rng: np.random.Generator) -> dict[str, Any]:
    """Return a diffuser, thin or thick, clear or milky."""
    between = log_uniform(rng)
    return {
        "thickness": (between(0.3, 3.0), MM),
        "sigma_s": (float(rng.choice([0.0, between(0.05, 20.0)])), "1/mm"),
        "sigma_a": (between(0.001, 0.3), "1/mm"),
        "g": (rng.uniform(-0.3, 0.9),),
    }


def _face(edge: str, rng: np.random.Generator) -> dict[str, Any] | None:
    """Return what is said of an edge, None where nothing is."""
    kinds: list[Callable[[], dict[str, Any] | None]] = [
        lambda: painted("black", edge),
        lambda: painted("white", edge, reflectance=rng.uniform(0.3, 0.95)),
        lambda: painted("mirror", edge, reflectance=rng.uniform(0.5, 0.98)),
        lambda: rough(_roughness(rng), edge),
        lambda: None,
    ]
    return kinds[rng.choice(5, p=[0.1, 0.15, 0.1, 0.2, 0.45])]()


def _profile(rng: np.random.Generator) -> Any:
    between, kind = log_uniform(rng), rng.choice(3)
    gaussian = {"sigma_v": (between(2.0, 60.0), DEG)}
    return (LAMBERTIAN, gaussian, {"cosine_exponent": (between(1.0, 60.0),)})[kind]


def _listed(rng: np.random.Generator, plate: float) -> dict[str, Any]:
    """Return a lamp under the pad or in its silicone, in the middle."""
    between, below = log_uniform(rng), rng.random() < 0.6
    x, y, u, v = rng.uniform([-6.0, -7.0, -0.6, -0.6], [6.0, 7.0, 0.6, 0.6]).tolist()
    z = -plate - rng.uniform(1.5, 8.0) if below else rng.uniform(0.6, 1.2)
    return {
        "position": ([x, y, float(z)], MM),
        "direction": ([u, v, 1.0],),
        "diameter": (between(0.2, 2.0) if below else between(0.1, 0.5), MM),
        "profile": _profile(rng),
        "turns": False,
    }
