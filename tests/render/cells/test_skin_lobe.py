"""The coating's lobe in the cell sampler: directions that are mixed with guided ones."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.optics.pad_scene import coated
from render.scene import Coating, unchecked
from tests.render.optics.test_coated_skin import directions, value

COUNT = 1 << 20
ALBEDO, SPECULAR, ALPHA = 0.4, 0.5, 0.2


@dataclass
class Upwards:
    """Four fifths of the directions are uniform over the hemisphere of the skin's normal."""

    mono: Any
    fraction: float = 0.8

    def applies(self, v: Any) -> Any:
        return v.diffuse

    def selected(self, v: Any, number: Any) -> Any:
        return number < self.fraction

    def unselected(self, v: Any, number: Any) -> Any:
        from render.cells.guiding import FacetGuiding

        return FacetGuiding.unselected(self, v, number)  # type: ignore[arg-type]

    def sample(self, v: Any, number: Any, x: Any, y: Any) -> Any:
        return self.mono.warp.square_to_uniform_hemisphere(self.mono.Point2f(x, y))

    def mixture_pdf(self, v: Any, direction: Any, pdf: Any) -> Any:
        uniform = dr.select(direction.z > 0, 0.5 / np.pi, 0.0)
        return (1 - self.fraction) * pdf + self.fraction * uniform


def skin_vertex(mono: ModuleType, bsdf: Any, view: np.ndarray) -> Any:
    from render.paths.vertex import empty_vertex

    v = empty_vertex()
    v.bsdf = mono.BSDFPtr(bsdf)
    v.n, v.wi = mono.Normal3f(0, 0, 1), mono.Vector3f(*view.tolist())
    v.diffuse, v.beta, v.weight = mono.Bool(True), mono.Spectrum(1.0), mono.Float(1.0)
    return v


def test_guided_directions_leave_both_parts_of_the_skin_their_share(mono: ModuleType) -> None:
    from render.paths.walk import begin_subpath, sample_scattering

    view = np.array([np.sin(0.6), 0.0, np.cos(0.6)])
    coating = Coating.model_construct(albedo=ALBEDO, specular=SPECULAR, roughness=ALPHA)
    bsdf = mono.load_dict(coated(coating))
    v = skin_vertex(mono, bsdf, view)
    rng = np.random.default_rng(7)
    numbers = tuple(mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(4))
    zero = mono.Float(0)
    state = begin_subpath(
        mono.Point3f(0), mono.Vector3f(0, 0, 1), dr.zeros(mono.MediumPtr), mono.Spectrum(1.0),
        zero, zero, mono.Float(0.5),
    )  # fmt: skip
    active = dr.full(mono.Bool, True, COUNT)
    following, alive = sample_scattering(
        state, v, mono.TransportMode.Radiance, numbers, active, Upwards(mono)
    )
    weight = np.array(following.beta)[0] * np.array(alive)
    drawn = np.array(following.d).T
    wo, solid = directions(192)
    flux = value(wo, view, ALBEDO, SPECULAR, ALPHA) * solid
    # About the mirror direction, where the lobe is, beside it, and on the other side.
    mirrored = np.array([-view[0], 0.0, view[2]])
    for low, high in ((-1.0, 0.3), (0.3, 0.9), (0.9, 1.0)):
        found = weight * ((drawn @ mirrored > low) & (drawn @ mirrored <= high))
        expected = flux[(wo @ mirrored > low) & (wo @ mirrored <= high)].sum()
        error = found.std() / np.sqrt(COUNT)
        assert found.mean() == pytest.approx(expected, abs=4 * error + 1e-3)
        assert error < 0.01 * flux.sum()
    # And what the balance heuristic is told of a direction is the density of the mixture.
    kept = weight > 0
    density = 1.0 / np.array(following.d_vcm)[kept]
    again = Upwards(mono).mixture_pdf(
        v, following.d, bsdf.pdf(mono.BSDFContext(), _interaction(mono, view), following.d)
    )
    np.testing.assert_allclose(density, np.array(again)[kept], rtol=1e-3)


def _interaction(mono: ModuleType, view: np.ndarray) -> Any:
    si = dr.zeros(mono.SurfaceInteraction3f, COUNT)
    si.wi = mono.Vector3f(*view.tolist())
    return si


@pytest.mark.slow
def test_a_lobe_that_takes_no_light_leaves_every_bit_of_a_render(mono: ModuleType) -> None:
    from render.reference import render_transport
    from tests.oracles.pads import scene_of_case

    plain = scene_of_case("rough 0.1")
    named = unchecked(
        plain, {"coating": unchecked(plain.coating, {"specular": 0.0, "roughness": 0.3})}
    )
    assert named.hash == plain.hash
    tables = [
        render_transport(scene, np.array([1.2]), np.zeros(1), samples=20, replicates=4)
        for scene in (plain, named)
    ]
    np.testing.assert_array_equal(tables[0].replicates, tables[1].replicates)
