"""Images over the smooth faces of a bent pad: their choice and what they carry."""

from __future__ import annotations

import itertools
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.arrays import Array
from render.cells.mirror_images import ImageChain, MirrorImages
from render.geometry.meshes import pad_grid
from render.pad import plane_faces
from render.paths.vertex import Vertex, empty_vertex
from render.scene import Scene
from tests.oracles.pads import CASES, painted, scene_of_case
from tests.render.cells.test_mirror_images import reflectance, straight_to_the_glow

BEND = np.pi / 4
SCENE = scene_of_case("smooth bent 45")
PAD = SCENE.pad
RADIUS = PAD.length / BEND
A, Y = (1.0, 2.0), (-6.0, -5.0)
"""Where two points of the coating are on the flat pad, x and y in mm."""


def bent(y: Array, z: Array) -> tuple[Array, Array]:
    """Return y and z in the world: an arc of constant coating length over the camera."""
    angle, radius = (y - SCENE.camera.pivot) / RADIUS, RADIUS + PAD.thickness - z
    across = SCENE.camera.pivot + radius * np.sin(angle)
    return across, PAD.thickness + RADIUS - radius * np.cos(angle)


def on_coating(mono: ModuleType, place: tuple[float, float], count: int = 1) -> Vertex:
    y, z = bent(np.array(place[1]), np.array(PAD.thickness))
    angle = (place[1] - SCENE.camera.pivot) / RADIUS
    # A hair inside: the coating is a polygon.
    normal = np.array([0.0, np.sin(angle), -np.cos(angle)])
    p = np.array([place[0], y, z]) + 0.01 * normal
    v = empty_vertex()
    v.p = mono.Point3f(*[mono.Float([c] * count) for c in p.tolist()])
    v.n = mono.Normal3f(*normal.tolist())
    v.frame = mono.Frame3f(mono.Vector3f(*normal.tolist()))
    v.wi = mono.Vector3f(*normal.tolist())
    v.beta = mono.Spectrum(1.0)
    v.diffuse, v.weight = mono.Bool(True), mono.Float(1.0)
    return v


def images_of(scene: Scene) -> MirrorImages:
    return MirrorImages(plane_faces(scene, BEND, False), scene.pad.index)


@pytest.fixture(scope="module")
def images(mono: ModuleType) -> MirrorImages:
    return images_of(SCENE)


def test_images_are_drawn_with_the_probability_that_is_stated(
    mono: ModuleType, images: MirrorImages
) -> None:
    count = 1 << 16
    number = mono.Float(np.random.default_rng(3).random(count).astype(np.float32))
    drawn, stated = images.draw(on_coating(mono, A, count), on_coating(mono, Y, count), number)
    drawn, stated = np.array(drawn), np.array(stated)
    assert drawn.min() >= 1
    found, counts = np.unique(drawn, return_counts=True)
    total = 0.0
    for image, times in zip(found, counts, strict=True):
        probability = float(
            dr.slice(
                images.probability(
                    mono.UInt32(int(image)), on_coating(mono, A), on_coating(mono, Y)
                )
            )
        )
        total += probability
        error = np.sqrt(probability * (1 - probability) / count)
        assert abs(times / count - probability) < 4.5 * error + 1e-5
        np.testing.assert_allclose(stated[drawn == image], probability, rtol=1e-4)
    # Over the lower face, over walls and over both.
    assert len(found) >= 5
    assert total == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("metal", [(), ("right", "base")])
def test_light_over_one_image_is_the_mirrors_part_of_the_inverse_square_law(
    mono: ModuleType, metal: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.optics.pad_scene import pad_scene

    faces = [painted("mirror", *metal, reflectance=0.6)] if metal else []
    monkeypatch.setitem(CASES, "this", CASES["smooth bent 45"] | {"faces": faces})
    scene = scene_of_case("this")
    images = images_of(scene)
    pad: Any = pad_scene(scene, BEND, False)
    bsdf = mono.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}})
    count = 1 << 15
    a, y = on_coating(mono, A, count), on_coating(mono, Y, count)
    for v in (a, y):
        v.bsdf = mono.BSDFPtr(bsdf)
        v.shape = mono.ShapePtr(next(s for s in pad.shapes() if s.id() == "coating"))
    number = mono.Float(np.random.default_rng(4).random(count).astype(np.float32))
    guiding = straight_to_the_glow(mono, SCENE, count, BEND)
    found = images.connect(pad, y, a, number, dr.full(mono.Bool, True, count), guiding)
    values = np.array(found, dtype=np.float64).ravel()

    # Every strip and both ends by Fermat: the shortest of many ways over points of the segment,
    # which is a reflection where it is not an end of it.
    lines = pad_grid(SCENE, BEND, False).y
    top = bent(lines[[0, -1]], np.full(2, PAD.thickness))
    bottom = bent(lines, np.zeros(len(lines)))
    outline = np.column_stack(
        [np.r_[top[0][0], bottom[0], top[0][1]], np.r_[top[1][0], bottom[1], top[1][1]]]
    )
    p_a, p_y = (np.array(v.p)[:, 0].astype(np.float64) for v in (a, y))
    n_a, n_y = (np.array(v.n)[:, 0].astype(np.float64) for v in (a, y))
    part = np.linspace(0.0, 1.0, 20_001)[:, None]
    total = 0.0
    names = ["base", *["lower"] * (len(lines) - 1), "tip"]
    sides = ((None, p_y[0]), ("left", -PAD.width - p_y[0]), ("right", PAD.width - p_y[0]))
    for side, x in sides:
        for name, (begin, end) in zip(names, itertools.pairwise(outline), strict=True):
            place = begin + part * (end - begin)
            legs = np.hypot(*(place - p_a[1:]).T), np.hypot(*(place - p_y[1:]).T)
            least = int((legs[0] + legs[1]).argmin())
            if least in (0, len(part) - 1):
                continue
            across, length = x - p_a[0], legs[0][least] + legs[1][least]
            distance = np.hypot(across, length)
            leave = np.array([across, *(length * (place[least] - p_a[1:]) / legs[0][least])])
            arrive = np.array([across, *(length * (place[least] - p_y[1:]) / legs[1][least])])
            leave, arrive = leave / distance, arrive / distance
            normal = np.array([end[1] - begin[1], begin[0] - end[0]])
            normal /= np.hypot(*normal)
            reflected = reflectance(scene, name, leave[1:] @ normal)
            reflected *= reflectance(scene, side, across / distance)
            cosines = max(leave @ n_a, 0.0) * max(arrive @ n_y, 0.0)
            total += (0.5 / np.pi) ** 2 * cosines * reflected / distance**2
    error = values.std() / np.sqrt(count)
    assert error < 0.02 * total
    assert abs(values.mean() - total) < 4 * error + 1e-4 * total


def test_an_image_and_a_camera_subpath_to_a_volume_weigh_each_other_alike(mono: ModuleType) -> None:
    """Where nothing else competes and both are as likely as each other, each counts half."""
    from render.optics.pad_scene import pad_scene
    from render.paths.connect import optical_depth, trace_to_surface
    from render.paths.vertex import evaluate_scattering
    from render.paths.walk import begin_subpath, guided_pdf

    scene = scene_of_case("rim bent 45")
    pad, images = pad_scene(scene, BEND, False), images_of(scene)
    shapes = {shape.id(): shape for shape in pad.shapes()}
    (medium,) = {s.interior_medium() for s in shapes.values()} - {None}
    count = 1 << 12
    a, y = on_coating(mono, A, count), on_coating(mono, (-9.2, -3.0), count)
    bsdf = mono.load_dict({"type": "diffuse"})
    a.bsdf, a.shape = mono.BSDFPtr(bsdf), mono.ShapePtr(shapes["coating"])
    a.phase = y.phase = mono.MediumPtr(medium).phase_function()
    y.volume, y.diffuse, y.medium = mono.Bool(True), mono.Bool(False), mono.MediumPtr(medium)
    inward = mono.Vector3f(*(float(c[0]) for c in np.array(y.n)))
    y.p = mono.Point3f(y.p + 2.0 * inward)
    number = mono.Float(np.random.default_rng(5).random(count).astype(np.float32))
    image, _ = images.draw(a, y, number)
    active = (image > 0) & (image % 3 == 0)  # over one strip alone
    guiding = straight_to_the_glow(mono, scene, count, BEND)
    # ------------------------ The camera subpath: to the strip, and on to y -----------------
    direction = dr.normalize(images.point(image, y.p) - a.p)
    b, depth, hit = trace_to_surface(pad, a, direction, active)
    _, pdf, _ = evaluate_scattering(a, direction, mono.TransportMode.Radiance, active)
    zero, clear = mono.Float(0.0), dr.zeros(mono.MediumPtr)
    state = begin_subpath(a.p, direction, clear, mono.Spectrum(1.0), zero, zero, zero)
    state.depth, chain = depth, ImageChain.closed()
    chain.open, chain.d_vcm = mono.Bool(True), dr.rcp(guided_pdf(guiding, a, direction, pdf))
    chain, _ = images.arrive(chain, b, state, a, mono.Bool(False))
    state.d, (state.depth, seen) = images.folded(image, direction), optical_depth(pad, y, b, active)
    _, ratio = images.arrive(chain, y, state, a, mono.Bool(True))
    # ------------------------ The image connection, with and without it ---------------------
    alone = images.connect(pad, y, a, number, active, guiding)
    y.d_vcm = ratio
    both = images.connect(pad, y, a, number, active, guiding)
    known = np.array(active & hit & seen & (alone[0] > 0))
    assert known.sum() > count // 8
    half = np.array(both).ravel() / np.maximum(np.array(alone).ravel(), 1e-30)
    np.testing.assert_allclose(half[known], 0.5, rtol=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_vertex_lies_in_the_strip_or_end_that_it_is_on_whichever_way_normals_point(
    mono: ModuleType, images: MirrorImages, side: float
) -> None:
    """Those of metal point into the pad, those of boundaries to the air out of it."""
    walls, outline = plane_faces(SCENE, BEND, False)
    v = empty_vertex()
    v.p = mono.Point3f(np.array([f.point + 0.5 * f.length * f.along for f in outline]).T)
    v.n = mono.Normal3f(side * np.array([f.inward for f in outline]).T)
    v.delta = mono.Bool(True)
    np.testing.assert_array_equal(images.mirror_at(v), len(walls) + 1 + np.arange(len(outline)))
