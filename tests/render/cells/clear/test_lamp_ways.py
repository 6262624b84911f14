"""Ways of light into a flat pad: lines that obey Snell's law, and the density of joining them."""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest

from render.cells.clear.lamp_ways import LampWays
from render.cells.clear.unfolded_cells import CELL_MAX, DEPTHS
from render.cells.fiber_light import FiberLight
from render.scene import FACES, OUTWARD, Scene
from tests.oracles.pads import scene_of_case

INDEX = 1.41
COUNT = 400


class End(NamedTuple):
    """Where a ray leaves the pad: through which face, from where and which way; its reflections."""

    face: int
    exit: np.ndarray
    outside: np.ndarray
    reflections: tuple[int, int, int]


def leaves(scene: Scene, p: np.ndarray, d: np.ndarray, face: int, bounces: int) -> End | None:
    """Follow a ray inside the box, plane by plane, until it leaves through ``face``."""
    low, high = scene.box.low, scene.box.high
    p, d, counts = p.astype(float), d.astype(float), [0, 0, 0]
    for _ in range(bounces + 1):
        with np.errstate(divide="ignore"):
            t = np.where(d > 0, (high - p) / d, (low - p) / d)
        axis = int(np.argmin(np.where(np.abs(d) > 0, t, np.inf)))
        p = p + t[axis] * d
        outward = np.zeros(3)
        outward[axis] = np.sign(d[axis])
        # Under the skin it is dark; beside it, over a clear rim, the top reflects.
        beside = (np.abs(p[:2]) > [scene.pad.width / 2, scene.pad.length / 2]).any()
        if np.allclose(outward, [0, 0, 1]) and not beside:
            return None
        if sum(counts) == bounces and np.allclose(outward, OUTWARD[face]):
            along = d - (d @ outward) * outward
            sine2 = INDEX**2 * (along @ along)
            if sine2 >= 1.0:
                return None
            outside = INDEX * along + np.sqrt(1.0 - sine2) * outward
            return End(face, p, outside, (counts[0], counts[1], counts[2]))
        d = d - 2 * (d @ outward) * outward
        counts[axis] += 1
    return None


@pytest.fixture(scope="module", params=["smooth", "clear rim"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return scene_of_case(request.param)


@pytest.fixture(scope="module")
def ways(mono: ModuleType, scene: Scene) -> LampWays:
    return LampWays(scene, FiberLight(scene, np.full((scene.lamp_count, 1), 1.2), 0.0))


def decoded(code: int) -> tuple[int, tuple[int, int, int]]:
    size = 2 * CELL_MAX + 1
    face, rest = divmod(code, DEPTHS * size**2)
    x, rest = divmod(rest, DEPTHS * size)
    y, z = divmod(rest, DEPTHS)
    return face, (x - CELL_MAX, y - CELL_MAX, -z)


def test_every_way_is_one_that_a_ray_in_the_box_goes(
    mono: ModuleType, scene: Scene, ways: LampWays
) -> None:
    rng = np.random.default_rng(4)
    low, high = scene.box.low, scene.box.high
    known, over_rim = 0, 0
    for entry, code in enumerate(np.array(ways.code_of)):
        face, cells = decoded(int(code))
        a = low + (high - low) * rng.random((COUNT, 3))
        square = rng.random((2, COUNT)).astype(np.float32)
        lamp = mono.UInt32(np.full(COUNT, np.array(ways.lamp_of)[entry], dtype=np.uint32))
        square_points = mono.Point2f(mono.Float(square[0]), mono.Float(square[1]))
        found = ways.join(
            mono.UInt32(np.full(COUNT, entry, dtype=np.uint32)), lamp,
            mono.Point3f(*(mono.Float(part.astype(np.float32)) for part in a.T)),
            mono.Float(0.5), square_points,
        )  # fmt: skip
        point = np.array(ways.light.sample_position(lamp, mono.Float(0.5), square_points)[0]).T
        direction = np.array(found.direction).T
        valid = np.nonzero(np.array(found.valid))[0]
        # What hits the skin on the way is told apart by a ray, not by the way.
        for i in valid[:20]:
            end = leaves(scene, a[i], direction[i], face, sum(map(abs, cells)))
            if end is None:
                continue
            known += 1
            over_rim += cells[2] == -2
            assert end.reflections == tuple(map(abs, cells)), (FACES[face], cells)
            np.testing.assert_allclose(np.array(found.line.exit).T[i], end.exit, atol=2e-4)
            # Grazing lines are known less well, and light hardly comes by them.
            span = point[i] - end.exit
            missed = np.linalg.norm(span - (span @ end.outside) * end.outside)
            assert missed < 1e-4 / np.array(found.line.outside_cos)[i]
    assert known > 500
    assert (over_rim > 50) == scene.box.layered.any()


def test_the_density_of_joining_is_that_of_an_area_over_what_refraction_spreads(
    mono: ModuleType, scene: Scene, ways: LampWays
) -> None:
    """Against the solid angle, by finite differences, that a ray sweeps on the lamp's disk."""
    a = np.array([3.0, -2.0, 3.1])
    known = 0
    for entry, code in enumerate(np.array(ways.code_of)):
        face, cells = decoded(int(code))
        lamp = int(np.array(ways.lamp_of)[entry])
        found = ways.join(
            mono.UInt32(entry), mono.UInt32(lamp), mono.Point3f(*a.tolist()), mono.Float(0.5),
            mono.Point2f(0.5, 0.5),
        )  # fmt: skip
        direction = np.array(found.direction, dtype=float).ravel()
        bounces = sum(map(abs, cells))
        if not np.array(found.valid)[0] or leaves(scene, a, direction, face, bounces) is None:
            continue
        beam = np.array(ways.light.beam_of(mono.UInt32(lamp), mono.UInt32(0))).ravel()
        center = np.array(ways.light.center_of(mono.UInt32(lamp))).ravel()
        tangent = np.linalg.svd(direction[None])[2][1:]
        step, hits = 1e-4, []
        for t in (*tangent, *-tangent):
            turned = direction + step * t
            end = leaves(scene, a, turned / np.linalg.norm(turned), face, bounces)
            assert end is not None
            distance = ((center - end.exit) @ beam) / (end.outside @ beam)
            hits.append(end.exit + distance * end.outside)
        area = np.linalg.norm(np.cross(hits[0] - hits[2], hits[1] - hits[3])) / (2 * step) ** 2
        radius = float(np.array(ways.light.radius)[lamp])
        stated = float(np.array(ways.along(mono.UInt32(lamp), found.line).joined)[0])
        if stated > 0 and np.array(found.line.outside_cos)[0] > 0.1:
            known += 1
            assert stated == pytest.approx(area / (np.pi * radius**2), rel=2e-3)
    assert known > 5


def test_what_vertices_evaluate_is_drawn_with_the_probability_that_is_stated(
    mono: ModuleType, ways: LampWays
) -> None:
    count = 1 << 14
    number = mono.Float(np.random.default_rng(2).random(count).astype(np.float32))
    for facet in (True, False):
        times = np.zeros(ways.entries + 1)
        draws = ways.draws
        steps = draws.facet_count if facet else ways.lamps
        for step in range(steps):
            at = mono.UInt32(np.full(count, step, dtype=np.uint32))
            entry = (
                draws.at_facet(at, number)[0]
                if facet
                else draws.later(at, number, mono.Bool(False))
            )
            times += np.bincount(np.array(entry), minlength=ways.entries + 1)
        every = mono.UInt32(np.arange(ways.entries, dtype=np.uint32))
        stated = np.array(draws.probability(every, mono.Bool(facet)))
        np.testing.assert_allclose(times[:-1] / count, stated, atol=0.02)
        assert (stated > 0).sum() > ways.lamps


def test_a_face_without_a_mirror_reflects_no_way(mono: ModuleType) -> None:
    scene = scene_of_case("black walls")
    ways = LampWays(scene, FiberLight(scene, np.full((scene.lamp_count, 1), 1.2), 0.0))
    right, base = FACES.index("right"), FACES.index("base")
    for code in np.array(ways.code_of):
        face, (x, y, _) = decoded(int(code))
        assert face not in (right, base)
        # The walls at +x and -y are black: one reflection at -x or +y remains.
        assert x in (-1, 0)
        assert y in (0, 1)
