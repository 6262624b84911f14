"""Target weights of light vertices are the light that they send to the coating, in closed form."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest

from render.scene import load_scene


def henyey_greenstein(g: float, cosine: float) -> float:
    """Return the phase function (1/sr) for the cosine between the ways in and on."""
    return float((1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5))


def test_a_target_weight_is_the_direct_and_the_mirrored_light_of_its_vertex(
    mono: ModuleType,
) -> None:
    from render.cells import light_subpaths
    from render.cells.lower_face_mirror import LowerFaceMirror
    from render.paths.vertex import empty_vertex

    scene = load_scene("finger20")
    assert scene.diffuser is not None
    target = light_subpaths.CoatingTarget(scene, 0.0, LowerFaceMirror(scene, 0.0))
    phase = mono.load_dict({"type": "hg", "g": scene.diffuser.g})
    # Inside the clear pad, so nothing is absorbed; on its way along +x, lit with beta 2.
    place, point, way = np.array([1.0, 2.0, 1.0]), np.array([3.0, 3.0, 4.0]), np.array([1.0, 0, 0])
    y = empty_vertex()
    y.p, y.wi, y.beta = mono.Point3f(place), mono.Vector3f(-way), mono.Spectrum(2.0)
    y.phase, y.volume, y.weight = mono.PhaseFunctionPtr(phase), mono.Bool(True), mono.Float(1.0)
    found = target.weight(
        y, mono.Bool(False), mono.Point3f(point), mono.Vector3f(0, 0, -1), mono.Bool(True)
    )

    def sent(image: np.ndarray, least: float) -> tuple[float, np.ndarray]:
        span = image - place
        w = span / np.linalg.norm(span)
        facing = abs(w[2]) + light_subpaths.TILT_COSINE
        value = 2.0 * (henyey_greenstein(scene.diffuser.g, float(w @ way)) + least)  # type: ignore[union-attr]
        return value * facing / float(span @ span), w

    direct, _ = sent(point, light_subpaths.ISOTROPIC_FRACTION)
    mirrored, w = sent(point * [1, 1, -1], 0.0)
    total_reflection = w[2] ** 2 < 1 - scene.pad.index**-2
    mirrored *= 1.0 if total_reflection else light_subpaths.PARTIAL_REFLECTANCE
    assert float(dr.slice(found)) == pytest.approx(direct + mirrored, rel=1e-5)
