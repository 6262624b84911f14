"""Lamps in a pad over a window of another index, over facing walls: ways and what they carry.

Each line to an image is followed face by face by Snell's and Fresnel's equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.bonded_lamp_images import BondedLampImages
from render.cells.fiber_light import FiberLight
from render.cells.guiding import FacetGuiding, FiberGlow
from render.cells.lamp_cells import IN_WINDOW, THROUGH_BOND
from render.cells.lamp_images import NO_IMAGE
from render.cells.mirror_images import FoldedWay
from render.optics.pad_scene import pad_scene
from render.paths.vertex import Vertex
from render.scene import FACES, Scene
from tests.oracles.pads import scene_of_case
from tests.render.cells.test_bonded_images import fresnel
from tests.render.cells.test_box_images import on_coating
from tests.render.cells.test_lamp_images import drawn_images

COUNT = 3000
CASES = [
    "cast in over a window",
    "cast in over a window between mirrors",
    "cast into a window between mirrors",
]


@pytest.fixture(scope="module", params=[*CASES, "a window of low index"])
def scene(request: pytest.FixtureRequest) -> Scene:
    if request.param in CASES:
        return scene_of_case(request.param)
    scene = scene_of_case("cast in over a window between mirrors")
    assert scene.window is not None
    window = scene.window.model_copy(update={"index": 1.33})
    return scene.model_copy(update={"window": window})


def images_of(scene: Scene) -> BondedLampImages:
    return BondedLampImages(scene, FiberLight(scene, np.zeros((scene.lamp_count, 1)), 0.0))


@dataclass
class Lines:
    """Lines from points ``a`` ``(n, 3)`` mm to images of lamps, ``length`` mm long."""

    lamp: np.ndarray
    image: np.ndarray
    a: np.ndarray
    direction: np.ndarray
    length: np.ndarray
    joined: np.ndarray
    """Density of joining, per solid angle at ``a``, without the choice of an image."""


def lines_to_images(scene: Scene, images: BondedLampImages, later: bool = False) -> Lines:
    import mitsuba as mi

    rng = np.random.default_rng(1)
    lamp = rng.integers(0, scene.lamp_count, COUNT).astype(np.uint32)
    image = drawn_images(images, lamp, later, rng)
    lamp, image = lamp[image != NO_IMAGE], image[image != NO_IMAGE]
    count = len(image)
    half = np.array([scene.pad.width, scene.pad.length]) / 2 - 1.0
    a = np.column_stack([rng.uniform(-half, half, (count, 2)), np.full(count, scene.pad.thickness)])
    pick, x, y = rng.random((3, count))
    direction, length, ray = images.line(
        mi.UInt32(image), mi.UInt32(lamp), mi.Point3f(a.T), mi.Float(pick), mi.Point2f(x, y)
    )
    return Lines(lamp, image, a, np.array(direction).T, np.array(length), np.array(ray.joined))


@dataclass
class Followed:
    """A ray through pad and window, ``length`` mm long: its end, direction there and light."""

    p: np.ndarray
    d: np.ndarray
    carried: float
    across: float
    levels: int
    bonds: int


def followed(scene: Scene, a: np.ndarray, d: np.ndarray, length: float, turns: int) -> Followed:
    """Follow a ray that passes the bond, and again after so many ``turns`` at the lower face.

    Without turns it is reflected by the bond, and with -1 of them it stays in the window.
    """
    assert scene.window is not None
    pad, window = scene.pad.index, scene.window.index
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    p, d = a.astype(float).copy(), d.astype(float) / np.linalg.norm(d)
    light, across, levels, bonds, in_window = 1.0, 0.0, 0, 0, False
    while True:
        low = np.array([*-half, -scene.window.thickness if in_window else 0.0])
        high = np.array([*half, 0.0 if in_window else scene.pad.thickness])
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(d > 0, (high - p) / d, np.where(d < 0, (low - p) / d, np.inf))
        axis = int(ahead.argmin())
        step = min(float(ahead[axis]), length)
        p, length = p + step * d, length - step
        across += step * float(np.hypot(d[0], d[1]))
        if length <= 0.0:
            return Followed(p, d, light, across, levels, bonds)
        index = window if in_window else pad
        if axis < 2:
            mirror = wall_of(scene, axis, bool(d[axis] > 0))
            light *= fresnel(abs(d[axis]), index) if mirror is None else mirror
            d[axis] = -d[axis]
        elif abs(p[2]) < 1e-9:
            other = pad if in_window else window
            reflected = fresnel(abs(d[2]), index / other)
            if not turns or (in_window and (turns < 0 or levels < 2 * turns - 1)):
                light, levels = light * reflected, levels + 1
                d[2] = -d[2]
                continue
            light, bonds, in_window = light * (1.0 - reflected), bonds + 1, not in_window
            d[:2] *= index / other
            d[2] = np.sign(d[2]) * np.sqrt(1.0 - d[0] ** 2 - d[1] ** 2)
        else:
            light, levels = light * fresnel(abs(d[2]), index), levels + 1
            d[2] = -d[2]


def wall_of(scene: Scene, axis: int, upper: bool) -> float | None:
    """Return what the metal on a wall reflects; None without."""
    face = (("left", "right"), ("base", "tip"))[axis][upper]
    return scene.finishes[FACES.index(face)].metal


def along_the_bond(scene: Scene, direction: np.ndarray) -> bool:
    """Return whether light goes on almost along it, where single precision tells no end."""
    assert scene.window is not None
    sine = np.hypot(direction[0], direction[1]) * scene.pad.index / scene.window.index
    return bool(0.9995 < sine < 1.0005)


def turns_of(images: BondedLampImages, image: int) -> int:
    """Return how often the lower face reflects light that passes the bond twice; -1: once."""
    import mitsuba as mi

    depth = -int(images._cell(mi.UInt32([image]))[2][0])
    return -1 if depth >= IN_WINDOW else max(depth - THROUGH_BOND, 0)


@pytest.mark.parametrize("later", [False, True])
def test_lines_end_at_the_lamp_and_are_known_by_how_they_came(
    mono: ModuleType, scene: Scene, later: bool
) -> None:
    images = images_of(scene)
    lines = lines_to_images(scene, images, later)
    lamps, kinds = scene.placed_lamps(), set()
    for i in range(300):
        if along_the_bond(scene, lines.direction[i]):
            continue
        turns = turns_of(images, int(lines.image[i]))
        end = followed(scene, lines.a[i], lines.direction[i], float(lines.length[i]), turns)
        lamp = lamps[lines.lamp[i]]
        said = images.reflected(
            mono.UInt32([lines.image[i]]), mono.Point3f(*lines.a[i].tolist()),
            mono.Vector3f(*lines.direction[i].tolist()),
        )  # fmt: skip
        assert float(said[0]) == pytest.approx(end.carried, rel=0.02, abs=1e-9)
        rounding = 1e-3 + 2e-6 * lines.length[i]
        assert np.linalg.norm(end.p - lamp.position) < 0.51 * lamp.diameter + rounding
        found = images.along(
            mono.UInt32([lines.lamp[i]]), mono.Bool(later), mono.Point3f(*lines.a[i].tolist()),
            mono.Vector3f(*lines.direction[i].tolist()),
            FoldedWay(
                mono.Float(end.across), mono.UInt32(end.levels), mono.UInt32(end.bonds)
            ),
        )  # fmt: skip
        assert int(found[0]) == lines.image[i]
        kinds.add((end.levels, end.bonds))
    below = lamps[0].solid == "window"
    assert kinds >= ({(1, 1), (2, 1)} if below else {(0, 0), (1, 0), (1, 2), (3, 2)})


def test_joining_is_as_dense_as_directions_move_over_the_lamp(
    mono: ModuleType, scene: Scene
) -> None:
    """Area of the lamp's end per solid angle, by differences of followed rays."""
    images = images_of(scene)
    lines, tried = lines_to_images(scene, images), 0
    lamps = scene.placed_lamps()
    for i in range(200):
        if along_the_bond(scene, lines.direction[i]):
            continue
        a, d, length = lines.a[i], lines.direction[i].astype(float), float(lines.length[i])
        turns = turns_of(images, int(lines.image[i]))
        lamp = lamps[lines.lamp[i]]
        beam = np.array(images.light.beam_of(mono.UInt32(lines.lamp[i]), mono.UInt32(0))).ravel()
        other = np.cross(d, [0.0, 0.0, 1.0])
        other /= np.linalg.norm(other)
        step, ends = 1e-5, []
        for turned in (d, d + step * other, d + step * np.cross(other, d)):
            end = followed(scene, a, turned, length, turns)
            ends.append(end.p + end.d * ((lamp.position - end.p) @ beam) / (end.d @ beam))
        area = np.linalg.norm(np.cross(ends[1] - ends[0], ends[2] - ends[0])) / step**2
        if area > 1e5:
            continue
        tried += 1
        whole = np.pi * (lamp.diameter / 2) ** 2
        assert lines.joined[i] * whole == pytest.approx(area, rel=0.02)
    assert tried > 50


def test_what_is_joined_is_what_fresnel_says_face_by_face(mono: ModuleType, scene: Scene) -> None:
    """At vertices where paths end nothing competes: joining has all of the light."""
    images, rng, count = images_of(scene), np.random.default_rng(2), 400
    pad: Any = pad_scene(scene, 0.0, False)
    a = [1.0, 2.0, scene.pad.thickness]
    bsdf = mono.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}})
    vertex: Vertex = on_coating(mono, a, count)
    vertex.bsdf, vertex.frame = mono.BSDFPtr(bsdf), mono.Frame3f(mono.Vector3f(vertex.n))
    vertex.wi, vertex.beta = mono.Vector3f(vertex.n), mono.Spectrum(1.0)
    vertex.shape = mono.ShapePtr(next(s for s in pad.shapes() if s.id() == "coating"))
    vertex.terminal = mono.Bool(True)
    lamp = mono.UInt32(rng.integers(0, scene.lamp_count, count).astype(np.uint32))
    which, numbers = (
        tuple(mono.Float(row) for row in rng.random((4, count)).astype(np.float32))
        for _ in range(2)
    )
    later = mono.Bool(True)
    guiding = FacetGuiding(FiberGlow(scene, 0.0), dr.zeros(mono.UInt32, count))
    (found,) = images.joined(pad, lamp, later, vertex, which, numbers, guiding)
    image = np.array(images.drawn(lamp, later, which))
    direction, length, ray = images.line(
        mono.UInt32(image), lamp, vertex.p, numbers[0], mono.Point2f(numbers[1], numbers[2])
    )
    radiance, joined = np.array(ray.radiance[0]), np.array(ray.joined)
    scale = np.divide(radiance, joined, out=np.zeros_like(radiance), where=joined > 0)
    scale /= np.array(images.probability(lamp, later, mono.UInt32(image)))
    scale *= 0.5 / np.pi * np.abs(np.array(direction.z))
    ways, lengths, compared = np.array(direction).T, np.array(length), 0
    for i in np.flatnonzero((image != NO_IMAGE) & (scale > 0)).tolist():
        if along_the_bond(scene, ways[i]):
            continue
        turns = turns_of(images, int(image[i]))
        end = followed(scene, np.array(a), ways[i], float(lengths[i]), turns)
        compared += end.carried > 1e-6
        expected = scale[i] * end.carried
        assert float(found[i]) == pytest.approx(expected, rel=2e-3, abs=1e-6 * float(scale[i]))
    assert compared > 30
