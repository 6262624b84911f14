"""Reflection and transmission of plane-parallel slabs against adding-doubling (iadpython).

Adding-doubling solves the equation of transfer in an endless slab on a quadrature of angles,
without noise and without paths. Held against it: the walk that every subpath of level 2 takes
(``render.paths.walk``), and the analog tracer that is itself an oracle for whole pads.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import iadpython
import numpy as np
import pytest
from scipy import stats

from tests.long import LONG
from tests.oracles.analog_tracer import LEFT, OPEN, OUTSIDE, RIGHT, Lamp, Pad, trace_photons

ANGLES = {True: 24, False: 32}
"""Of the quadrature, in a matched slab and between faces: more of them lose energy by rounding."""
BOUND = 5e-4
"""Largest difference allowed, of the light that is sent in; with few photons noise decides."""
HALF_WIDTH = 100.0
"""Of the slab in mm: endless, for light that scatters every millimeter.

A slab of 0.02 mm would transmit 0.2 % too much by the walk: rays step off a face by about 1e-4 mm.
"""
BATCHES = 16


class Material(NamedTuple):
    """A slab: coefficients in 1/mm, thickness in mm, index against air outside."""

    sigma_s: float
    sigma_a: float
    g: float
    thickness: float
    index: float = 1.0


MATERIALS = [
    Material(4.0, 0.005, 0.75, 2.0),
    Material(4.0, 0.005, 0.75, 2.0, 1.41),
    Material(0.9, 0.1, 0.75, 2.0),
    Material(0.5, 0.0, 0.0, 1.0),
    Material(2.0, 0.0, 0.0, 2.0),
    Material(8.0, 0.0, 0.0, 1.0),
    Material(1.0, 1.0, 0.0, 1.0),
    Material(0.1, 0.4, 0.0, 2.0),
    Material(3.0, 0.1, 0.5, 1.0),
    Material(6.0, 0.02, 0.5, 2.0),
    Material(1.0, 0.01, -0.5, 2.0),
    Material(5.0, 0.5, -0.9, 1.0),
    Material(10.0, 0.0, 0.9, 1.0),
    Material(20.0, 0.1, 0.9, 2.0),
    Material(20.0, 0.01, 0.95, 1.0),
    Material(50.0, 0.001, 0.9, 1.0),
    Material(2.0, 0.05, 0.0, 1.0, 1.41),
    Material(8.0, 0.01, 0.5, 1.0, 1.41),
    Material(3.0, 0.3, 0.75, 1.0, 1.7),
    Material(1.0, 0.0, 0.5, 4.0, 1.7),
]
FAST = (0, 1, 10, 13)


def adding_doubling(material: Material, fewer: int = 0) -> tuple[float, float]:
    """Return reflected and transmitted parts of light that meets the slab upright."""
    extinction = material.sigma_s + material.sigma_a
    slab = iadpython.Sample(
        a=material.sigma_s / extinction,
        b=extinction * material.thickness,
        g=material.g,
        n=material.index,
        n_above=1.0,
        n_below=1.0,
        quad_pts=ANGLES[material.index == 1.0] - fewer,
    )
    reflected, transmitted, _, _ = slab.rt()
    return float(reflected), float(transmitted)


def walked(mono: ModuleType, material: Material, count: int, seed: int) -> np.ndarray:
    """Return reflected and transmitted parts ``(batch, 2)`` by the walk of all subpaths."""
    from tests.validation.slab_walk import escaping

    extinction = material.sigma_s + material.sigma_a
    face: dict[str, Any] = {"type": "null"}
    if material.index > 1.0:
        face = {"type": "dielectric", "int_ior": material.index, "ext_ior": 1.0}
    half = material.thickness / 2
    scene = mono.load_dict(
        {
            "type": "scene",
            "slab": {
                "type": "cube",
                "to_world": mono.ScalarTransform4f().scale([HALF_WIDTH, HALF_WIDTH, half]),
                "bsdf": face,
                "interior": {
                    "type": "homogeneous",
                    "sigma_t": extinction,
                    "albedo": material.sigma_s / extinction,
                    "phase": {"type": "hg", "g": material.g},
                },
            },
        }
    )

    return escaping(scene, -2 * half, count // BATCHES, BATCHES, seed)


def check(batches: np.ndarray, expected: tuple[float, float], what: str) -> None:
    """Fail where the mean of ``(batch, 2)`` differs from ``expected`` by more than its noise."""
    mean, error = batches.mean(axis=0), stats.sem(batches, axis=0)
    difference = mean - expected
    print(
        f"{what}: R {mean[0]:.5f}, off by {difference[0]:+.1e} +- {error[0]:.0e}; "
        f"T {mean[1]:.5f}, off by {difference[1]:+.1e} +- {error[1]:.0e}"
    )
    assert (error < 0.25 * BOUND if LONG else error < 4 * BOUND).all()
    assert (np.abs(difference) < 4.5 * error).all()
    assert not LONG or (np.abs(difference) < BOUND).all()


def of(materials: list[Material]) -> list[Material]:
    """Return all of ``materials``, or a few of them where there is little time."""
    return materials if LONG else [materials[i] for i in FAST]


def test_adding_doubling_itself_is_converged_in_its_angles_and_loses_nothing() -> None:
    for material in MATERIALS:
        np.testing.assert_allclose(
            adding_doubling(material), adding_doubling(material, fewer=4), atol=5e-5
        )
        assert sum(adding_doubling(material._replace(sigma_a=0.0))) == pytest.approx(1.0, abs=2e-6)
    # van de Hulst 1980, table 35: albedo 0.9, g 0.75, optical thickness 2.
    assert adding_doubling(Material(0.9, 0.1, 0.75, 2.0)) == pytest.approx(
        (0.09739, 0.66096), abs=1e-5
    )


@pytest.mark.parametrize("material", of(MATERIALS), ids=str)
def test_the_walk_of_level_2_reflects_and_transmits_as_adding_doubling_says(
    mono: ModuleType, material: Material
) -> None:
    count = 1 << 25 if LONG else 1 << 18
    check(walked(mono, material, count, 1), adding_doubling(material), f"walk, {material}")


@pytest.mark.parametrize("material", of(MATERIALS), ids=str)
def test_analog_photons_are_reflected_and_transmitted_as_adding_doubling_says(
    material: Material,
) -> None:
    wide = HALF_WIDTH
    # Nothing but rim: the slab's normal is x, and a thin beam comes from -x.
    pad = Pad(
        low=np.array([0.0, -wide, -wide]),
        high=np.array([material.thickness, wide, wide]),
        half_width=-1.0,
        half_length=wide,
        index=material.index,
        alpha=np.zeros(6),
        paint=np.full(6, OPEN),
        reflectance=np.zeros(6),
        sigma_s=material.sigma_s,
        sigma_a=material.sigma_a,
        g=material.g,
        albedo=0.0,
        apex=np.zeros((0, 3)),
        normal=np.array([[0.0, 0.0, -1.0]]),
        radius=1.0,
        subdivisions=1,
        pitch=wide,
        columns=1,
        rows=2,
    )
    beam = Lamp(np.array([-1.0, 0.0, 0.0]), np.eye(3)[:, [1, 2, 0]], 0.01, np.radians(0.1))
    beam = beam._replace(frame=np.ascontiguousarray(beam.frame))
    count = 1 << 25 if LONG else 1 << 17
    batches = []
    for batch in range(BATCHES):
        _, ends = trace_photons(pad, beam, count // BATCHES, 100 + batch, 2)
        batches.append([ends[LEFT] + ends[OUTSIDE], ends[RIGHT]])
    check(np.array(batches), adding_doubling(material), f"analog, {material}")
