"""Images over the smooth faces of a flat pad: their places, their choice and what they carry."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.guiding import GUIDED_FRACTION, FacetGuiding, FiberGlow
from render.cells.mirror_images import MirrorImages
from render.optics.pad_scene import pad_scene
from render.pad import plane_faces
from render.paths.vertex import Vertex, empty_vertex
from render.scene import Scene
from tests.oracles.analog_tracer import fresnel
from tests.oracles.pads import scene_of_case


def on_coating(mono: ModuleType, place: list[float], count: int = 1) -> Vertex:
    v = empty_vertex()
    v.p = mono.Point3f(*[mono.Float([c] * count) for c in place])
    v.n = mono.Normal3f(0.0, 0.0, -1.0)
    v.diffuse, v.weight = mono.Bool(True), mono.Float(1.0)
    return v


def straight_to_the_glow(
    mono: ModuleType, scene: Scene, count: int, bend: float = 0.0
) -> FacetGuiding:
    one, fiber = mono.Float(1.0), dr.zeros(mono.UInt32, count)
    return FacetGuiding([FiberGlow(scene, bend)], [one], GUIDED_FRACTION, fiber)


def connected(mono: ModuleType, scene: Scene, images: MirrorImages, count: int) -> np.ndarray:
    """Return the light between `A` and `Y` on a skin of albedo 0.5, over one image each time."""
    pad: Any = pad_scene(scene, 0.0, False)
    # Pointers do not keep it alive.
    bsdf = mono.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}})
    a, y = on_coating(mono, A, count), on_coating(mono, Y, count)
    for v in (a, y):
        v.bsdf = mono.BSDFPtr(bsdf)
        v.frame = mono.Frame3f(mono.Vector3f(v.n))
        v.wi = mono.Vector3f(v.n)
        v.beta = mono.Spectrum(1.0)
        v.shape = mono.ShapePtr(next(s for s in pad.shapes() if s.id() == "coating"))
    number = mono.Float(np.random.default_rng(4).random(count).astype(np.float32))
    guiding = straight_to_the_glow(mono, scene, count)
    found = images.connect(pad, y, a, number, dr.full(mono.Bool, True, count), guiding)
    return np.array(found, dtype=np.float64).ravel()


def images_of(scene: Scene) -> MirrorImages:
    return MirrorImages(plane_faces(scene, 0.0, False), scene.pad.index)


@pytest.fixture(scope="module")
def images(mono: ModuleType) -> MirrorImages:
    return images_of(scene_of_case("smooth"))


A, Y = [1.0, 2.0, 4.5], [-6.0, -3.0, 4.5]


def test_an_image_lies_behind_its_mirrors_and_twice_mirrored_is_the_point(
    mono: ModuleType, images: MirrorImages
) -> None:
    p = mono.Point3f(*Y)
    # x over the wall at -10, y over none, z over the lower face.
    image = mono.UInt32(1 + 9)
    np.testing.assert_allclose(np.array(images.point(image, p)).ravel(), [-14.0, -3.0, -4.5])
    np.testing.assert_allclose(
        np.array(images.point(image, images.point(image, p))).ravel(), Y, atol=1e-5
    )


def test_images_are_drawn_with_the_probability_that_is_stated(
    mono: ModuleType, images: MirrorImages
) -> None:
    count = 1 << 16
    a, y = on_coating(mono, A, count), on_coating(mono, Y, count)
    number = mono.Float(np.random.default_rng(3).random(count).astype(np.float32))
    drawn, stated = images.draw(a, y, number)
    drawn, stated = np.array(drawn), np.array(stated)
    assert drawn.min() >= 1
    total = 0.0
    for image in range(1, 18):
        probability = float(
            dr.slice(
                images.probability(mono.UInt32(image), on_coating(mono, A), on_coating(mono, Y))
            )
        )
        total += probability
        error = np.sqrt(probability * (1 - probability) / count)
        assert abs((drawn == image).mean() - probability) < 4.5 * error + 1e-5
        np.testing.assert_allclose(stated[drawn == image], probability, rtol=1e-4)
    assert total == pytest.approx(1.0, rel=1e-5)


def reflectance(scene: Scene, face: str | None, cosine: float) -> float:
    """Return what a mirror reflects in the pad, 1 for none (Fresnel, both polarizations)."""
    if face is None:
        return 1.0
    metal = scene.finish(face).metal
    if metal is not None:
        return metal
    return fresnel(abs(cosine), 1.0 / scene.pad.index)[0]


@pytest.mark.parametrize("case", ["smooth", "mirror walls"])
def test_light_over_one_image_is_the_mirrors_part_of_the_inverse_square_law(
    mono: ModuleType, case: str
) -> None:
    scene, count = scene_of_case(case), 1 << 14
    values = connected(mono, scene, images_of(scene), count)
    # Every image that the box has, in closed form; both cosines are that to the normal, z.
    total = 0.0
    width, length = scene.pad.width, scene.pad.length
    for side, x in ((None, Y[0]), ("left", -width - Y[0]), ("right", width - Y[0])):
        for end, along in ((None, Y[1]), ("base", -length - Y[1]), ("tip", length - Y[1])):
            # Without the lower face the way would lie in the coating.
            span = np.array([x, along, -Y[2]]) - A
            d = span / np.linalg.norm(span)
            reflected = reflectance(scene, "lower", d[2]) * reflectance(scene, side, d[0])
            reflected *= reflectance(scene, end, d[1])
            total += (0.5 / np.pi) ** 2 * d[2] ** 2 * reflected / (span @ span)
    error = values.std() / np.sqrt(count)
    assert error < 0.02 * total
    assert abs(values.mean() - total) < 4 * error
