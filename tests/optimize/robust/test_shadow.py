"""Light that a bolt hides: against walks along lines and strengths that are computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design
from optimize.robust.shadow import PressedCylinder, ShadowPenalty, hidden_fraction
from optimize.scoring import TableScorer
from optimize.search import NominalScore, WeightedSum, refine_by
from render.errors import SceneError, TableError
from render.geometry import flat_sites
from render.preview import point_lights
from render.scene import OUTWARD, Scene, unchecked
from render.transport import TransportTable
from tests.oracles.pads import scene_of_case


def blocked_by_brute_force(
    scene: Scene, bolt: PressedCylinder, site: int, point: np.ndarray
) -> np.ndarray:
    """Return which lights ``(fiber, light)`` a point cannot see, by walking along the lines."""
    lights = point_lights(scene).position[..., :3]
    start = np.append(point, scene.pad.thickness)
    steps = np.linspace(0.0, 1.0, 4001)[:, None, None, None]
    path = start + steps * (lights - start)
    away = np.linalg.norm(path[..., :2] - flat_sites(scene)[site, :2], axis=-1)
    inside = (away < bolt.radius) & (path[..., 2] > scene.pad.thickness - bolt.depth)
    return np.asarray(inside.any(axis=0))


def test_hidden_light_equals_a_walk_along_the_lines(finger20: Scene) -> None:
    bolt = PressedCylinder(radius=2.0, depth=1.2, distance=0.5, points=4)
    found = hidden_fraction(finger20, np.array([np.pi / 2]), bolt)[:, 0]
    site = 4
    for index in range(4):
        turn = np.pi / 2 * index
        out = (bolt.radius + bolt.distance) * np.array([np.cos(turn), np.sin(turn)])
        blocked = blocked_by_brute_force(finger20, bolt, site, flat_sites(finger20)[site, :2] + out)
        for fiber in range(finger20.lamp_count):
            if blocked[fiber].all():
                assert found[fiber, site, index] == pytest.approx(1.0)
            elif not blocked[fiber].any():
                assert found[fiber, site, index] == 0.0
            else:
                assert 0.0 <= found[fiber, site, index] <= 1.0


@pytest.fixture
def thin(finger20: Scene) -> Scene:
    """Return the sensor with a layer that 13 % of the light passes straight."""
    assert finger20.diffuser is not None
    layer = unchecked(finger20.diffuser, {"thickness": 0.5})
    return unchecked(finger20, {"diffuser": layer})


def sent_by_beam(scene: Scene, direction: np.ndarray, phi: float, peak: float) -> float:
    """Return the intensity of a fiber's end in ``direction`` (along the edge, inwards, up).

    From the definition of the beam (thesis 3.3.1), Snell's and Fresnel's laws at the layer's outer
    face (index matched to the pad) and Beer and Lambert's inside, one number after the other.
    """
    assert scene.diffuser is not None
    along, inwards, up = direction
    n, tilt = scene.pad.index, scene.fibers.tilt
    sine_pad = math.hypot(along, up)
    if inwards <= 0 or n * sine_pad >= 1:
        return 0.0
    cos_pad, cos_air = inwards, math.sqrt(1 - (n * sine_pad) ** 2)
    axis = (math.cos(tilt) * math.cos(phi), math.cos(tilt) * math.sin(phi), math.sin(tilt))
    cosine = n * along * axis[0] + cos_air * axis[1] + n * up * axis[2]
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    s = (cos_air - n * cos_pad) / (cos_air + n * cos_pad)
    p = (n * cos_air - cos_pad) / (n * cos_air + cos_pad)
    extinction = scene.diffuser.sigma_s + scene.diffuser.sigma_a
    return (
        peak
        * math.exp(-((angle / (2 * scene.fibers.sigma_v)) ** 2))
        * max(cosine, 0.0)
        * (1 - (s**2 + p**2) / 2)
        * math.exp(-extinction * scene.diffuser.thickness / cos_pad)
        * n**2 * cos_pad / cos_air
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("phi", [np.pi / 2, 1.1, 2.3])
def test_a_thin_layer_lets_beams_pass_and_their_shadow_is_what_they_send(
    thin: Scene, phi: float
) -> None:
    bolt = PressedCylinder(radius=2.0, depth=1.2, distance=0.5, points=4)
    lights, angles = point_lights(thin), np.full(thin.lamp_count, phi)
    emission, marks = lights.emission(angles), lights.position[..., 3].astype(int)
    found, beams_matter = hidden_fraction(thin, np.array([phi]), bolt)[:, 0], 0
    for site, index in ((0, 0), (4, 1), (4, 3), (7, 2), (14, 2)):
        turn = np.pi / 2 * index
        out = (bolt.radius + bolt.distance) * np.array([np.cos(turn), np.sin(turn)])
        point = np.append(flat_sites(thin)[site, :2] + out, thin.pad.thickness)
        blocked = blocked_by_brute_force(thin, bolt, site, point[:2])
        for fiber in range(thin.lamp_count):
            sums = {"glow": np.zeros(2), "beam": np.zeros(2)}
            for light, mark in enumerate(marks[fiber]):
                if mark & 8 and mark >> 4 != 8 + 16 * 8:  # seen in a wall
                    continue
                way = point - lights.position[fiber, light, :3]
                distance = np.linalg.norm(way)
                x, y, z = way / distance
                edge = {0: (y, x, z), 1: (x, -y, z), 2: (y, -x, z)}[mark % 8]
                if mark >= 8:
                    sent = sent_by_beam(thin, np.array(edge), phi, emission[fiber, light, 3])
                else:
                    sent = max(emission[fiber, light, 0], 0.0) * max(edge[1], 0.0)
                light_here = sent * z / distance**2
                kind = "beam" if mark >= 4 else "glow"
                sums[kind] += light_here * np.array([1.0, blocked[fiber, light]])
            total, hidden = sums["glow"] + sums["beam"]
            assert found[fiber, site, index] == pytest.approx(hidden / total, rel=1e-6, abs=1e-9)
            beams_matter += sums["beam"][0] > 0.2 * total
    assert beams_matter > 10


def test_a_layer_that_hardly_scatters_hides_what_a_clear_pad_hides(finger20: Scene) -> None:
    assert finger20.diffuser is not None
    layer = unchecked(finger20.diffuser, {"thickness": 0.1, "sigma_s": 0.01})
    nearly = unchecked(finger20, {"diffuser": layer})
    gap = finger20.fibers.gap + 0.1 / finger20.pad.index
    fibers = unchecked(finger20.fibers, {"gap": gap})
    clear = unchecked(finger20, {"diffuser": None, "fibers": fibers})
    ahead = np.array([np.pi / 2])
    bolt = PressedCylinder(radius=2.0, depth=1.2, distance=0.5, points=8)
    thin, none = (hidden_fraction(scene, ahead, bolt)[:, 0] for scene in (nearly, clear))
    # Points that a beam straight ahead reaches: at most 20 deg off it.
    lights = point_lights(clear)
    azimuth = np.pi / 4 * np.arange(8)
    ring = 2.5 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    point = flat_sites(finger20)[:, None, :2] + ring
    offset = np.abs(point - lights.position[:, :1, None, :2])
    tip = (lights.position[:, 0, 3] % 8 == 1)[:, None, None]
    across = np.where(tip, offset[..., 0], offset[..., 1])
    into = np.where(tip, offset[..., 1], offset[..., 0])
    ahead_of = (across < np.tan(np.radians(20)) * into) & np.isfinite(none)
    assert ahead_of.sum() > 100
    assert np.abs(thin - none)[ahead_of].max() < 0.05


def test_a_flat_bolt_hides_nothing_and_a_deep_one_is_refused(finger20: Scene) -> None:
    phi = np.array([1.0])
    shallow = hidden_fraction(finger20, phi, PressedCylinder(depth=1e-6))
    assert np.nanmax(shallow) == 0.0
    with pytest.raises(SceneError, match="does not fit"):
        hidden_fraction(finger20, phi, PressedCylinder(depth=9.0))


def test_the_shadow_penalty_has_exact_derivatives_and_lowers_shadows(finger20: Scene) -> None:
    rng, phi = np.random.default_rng(0), np.linspace(0.0, np.pi, 5)
    shape = (20, 5, 1, 15, 4)
    transport = rng.uniform(0.5, 1.5, shape)
    table = TransportTable(
        transport, 0 * transport, phi, 5.0, 30.0, bends=np.zeros(1),
        background=transport.mean(axis=-1), background_se=np.zeros(shape[:-1]),
    )  # fmt: skip
    penalty, h = ShadowPenalty(finger20, table), 1e-6
    design = Design.of_colors(rng.uniform(0.5, 2.5, 20), rng.integers(0, 3, 20))
    value, slope, by_power = penalty.gradient(design)
    assert value < 0.0
    for fiber in (0, 9, 15):
        step = h * np.eye(20)[fiber]
        up, down = (penalty.value(replace(design, phi=design.phi + s * step)) for s in (1, -1))
        assert slope[fiber] == pytest.approx((up - down) / (2 * h), rel=1e-4, abs=1e-6)
    step = h * (1.0 - design.drive)
    change = penalty.value(replace(design, drive=design.drive + step)) - value
    assert (by_power * step).sum() == pytest.approx(change, rel=1e-4)
    scorer = TableScorer(table)
    plain = NominalScore(scorer)
    free = refine_by(scorer, plain, design).design
    goal = WeightedSum((1.0, plain), (5.0, penalty))
    shaded = refine_by(scorer, goal, design).design
    assert penalty.value(shaded) > penalty.value(free)
    with pytest.raises(TableError, match="bend 0"):
        ShadowPenalty(finger20, replace(table, bends=np.ones(1)))


def test_shadows_of_channels_are_those_of_their_own_light(finger20: Scene) -> None:
    rng, phi = np.random.default_rng(0), np.linspace(0.0, np.pi, 5)
    shape = (20, 5, 1, 15, 4, 3)
    transport = rng.uniform(0.5, 1.5, shape)
    table = TransportTable(
        transport, 0 * transport, phi, 5.0, 30.0, bends=np.zeros(1),
        background=transport.mean(axis=4), background_se=np.zeros((*shape[:4], 3)),
    )  # fmt: skip
    penalty, h = ShadowPenalty(finger20, table), 1e-6
    design = Design.of_colors(rng.uniform(0.5, 2.5, 20), rng.integers(0, 3, 20))
    _, slope, _ = penalty.gradient(design)
    step = h * np.eye(20)[9]
    up, down = (penalty.value(replace(design, phi=design.phi + s * step)) for s in (1, -1))
    assert slope[9] == pytest.approx((up - down) / (2 * h), rel=1e-4, abs=1e-6)
    # Of lamps of one color, only that channel's light is missed.
    red = Design.of_colors(design.phi, np.zeros(20, dtype=int))
    assert table.background is not None
    alone = replace(table, T=transport[..., 0], se=table.se[..., 0],
                    background=table.background[..., 0],
                    background_se=np.zeros(shape[:4]))  # fmt: skip
    assert penalty.value(red) == pytest.approx(ShadowPenalty(finger20, alone).value(red))


@pytest.mark.parametrize(
    ("case", "radius", "curved"), [("dome", 30.0, (1, 1)), ("arch", 20.0, (1, 0))]
)
def test_hidden_light_on_a_curved_skin_equals_a_walk_along_the_lines(
    case: str, radius: float, curved: tuple[int, int]
) -> None:
    scene, bolt = (
        scene_of_case(case),
        PressedCylinder(radius=1.5, depth=0.8, distance=0.5, points=4),
    )
    middle = np.array([0.0, 0.0, scene.pad.thickness - radius])

    def on_skin(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the point of the sphere or cylinder there, and its normal out of the pad."""
        across = np.array([x, y]) * curved
        place = np.array([x, y, middle[2] + math.sqrt(radius**2 - across @ across)])
        return place, (place - middle) * [*curved, 1] / radius

    lights = point_lights(scene)
    marks, strength = lights.position[..., 3].astype(int), lights.emission(np.full(2, np.pi / 2))
    found, partly = hidden_fraction(scene, np.array([np.pi / 2]), bolt)[:, 0], 0
    for site in range(scene.sites.count):
        center, up = on_skin(*flat_sites(scene)[site, :2])
        across = np.array([up[2], 0.0, -up[0]]) / math.hypot(up[0], up[2])
        for index, (c, s) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1))):
            ring = center + 2.0 * (c * across + s * np.cross(up, across))
            point, normal = on_skin(ring[0], ring[1])
            for fiber in range(scene.lamp_count):
                hidden = total = 0.0
                for light, mark in enumerate(marks[fiber]):
                    if mark >> 4 != 8 + 16 * 8:  # seen in a wall
                        continue
                    way = lights.position[fiber, light, :3] - point
                    path = point + np.linspace(0.0, 1.0, 4001)[:, None] * way - center
                    deep = -path @ up
                    away = np.linalg.norm(path + deep[:, None] * up, axis=-1)
                    inward = max(way @ OUTWARD[mark % 8], 0.0) * max(-way @ normal, 1e-6)
                    sent = strength[fiber, light, 3] * inward / (way @ way) ** 2
                    total += sent
                    hidden += sent * bool(((away < bolt.radius) & (deep < bolt.depth)).any())
                wanted = hidden / total if total > 0 else 0.0
                partly += wanted > 0.0
                assert found[fiber, site, index] == pytest.approx(wanted, abs=1e-6)
    assert partly > 4
