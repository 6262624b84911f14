"""Light subpaths on flat clear pads: where lamps light the skin, and what that is worth to others.

Absolute brightness is held against analog photons in ``tests/validation/test_clear_pads.py``.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.geometry import fiber_poses
from render.reference import pad_cells
from render.sampling.monte_carlo import MonteCarlo
from render.sampling.streams import HashedStream
from render.scene import Scene
from tests.oracles.pads import CASES, DEG, painted, scene_of_case

PHI = 1.2
REPLICATES = 16
LANES = 4096


def cells(scene: Scene) -> Any:
    return pad_cells(scene, np.full((scene.lamp_count, 1), PHI), 0.0, False)


def sums(sampler: Any, lanes: int, passes: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return the light of each lamp over all targets, and its standard error."""
    run = MonteCarlo(sampler, lanes, REPLICATES, 5)
    run.sample(passes)
    found = run.estimate().reshape(REPLICATES, sampler.fibers, -1).sum(axis=2)
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(REPLICATES)


def without_light_subpaths(mono: ModuleType, monkeypatch: pytest.MonkeyPatch, sampler: Any) -> Any:
    traced = sampler.spots.trace

    def nothing(stream: Any, lanes: int) -> Any:
        spots = traced(stream, lanes)
        spots.others = 0.0 * spots.others
        dr.make_opaque(spots.others)
        return spots

    monkeypatch.setattr(sampler.spots, "trace", nothing)
    monkeypatch.setattr(sampler.spots, "likelihood", lambda *_: mono.Float(0.0))
    return sampler


@pytest.mark.parametrize(
    "case",
    [
        "large lamp",
        "mirror walls",
        "white walls",
        "window",
        "window of low index under the lamps",
        "window with white walls",
        "window, white, black and mirror walls",
    ],
)
def test_light_subpaths_find_what_camera_subpaths_find(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    """Without them the cells are those that photons and lamp by lamp have been held against."""
    # Most of the light is that of spots.
    monkeypatch.setitem(CASES, "this", CASES[case] | {"coating.albedo": (0.9,)})
    scene = scene_of_case("this")
    both = sums(cells(scene), 1024)
    alone = sums(without_light_subpaths(mono, monkeypatch, cells(scene)), 8192)
    assert (both[1] < 0.005 * both[0]).all()
    assert (alone[1] < 0.02 * alone[0]).all()
    assert (np.abs(both[0] - alone[0]) < 4.0 * np.hypot(both[1], alone[1])).all()


def test_a_beam_like_a_ray_lights_the_skin_where_snells_law_says(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    narrow = {"fibers.sigma_v": (0.1, DEG), "fibers.tilt": (25.0, DEG)}
    monkeypatch.setitem(CASES, "this", narrow)
    scene = scene_of_case("this")
    sampler = cells(scene)
    stream = HashedStream(dr.arange(mono.UInt32, LANES) * 2654435761)
    spots = sampler.spots.trace(stream, LANES)
    poses = fiber_poses(scene, 0.0)
    n, albedo = scene.pad.index, float(np.mean(scene.coating.albedo))
    d = poses.directions(np.full((1, scene.lamp_count), PHI))[0]
    found = np.array(spots.p).reshape(3, scene.lamp_count, -1)
    sent = np.array(spots.sent[0]).reshape(scene.lamp_count, -1)
    for lamp in range(scene.lamp_count):
        inward = poses.face_inward[lamp]
        cosine = d[lamp] @ inward
        inside = np.sqrt(1 - (1 - cosine**2) / n**2)
        refracted = (d[lamp] - cosine * inward) / n + inside * inward
        entry = poses.position[lamp] + d[lamp] * (
            ((poses.foot[lamp] - poses.position[lamp]) @ inward) / cosine
        )
        skin = entry + refracted * (scene.pad.thickness - entry[2]) / refracted[2]
        lit = sent[lamp] > 0
        np.testing.assert_allclose(found[:, lamp][:, lit].mean(axis=1), skin, atol=0.02)
        # What Fresnel's equations let in, all of the power else: (n1 - n2) / (n1 + n2).
        s = (cosine - n * inside) / (cosine + n * inside)
        p = (n * cosine - inside) / (n * cosine + inside)
        through = 1 - (s**2 + p**2) / 2
        power = sent[lamp].mean() * np.pi * n**2 / albedo
        assert power == pytest.approx(through, abs=4 * 0.5 / np.sqrt(len(lit)))


def test_black_walls_send_nothing(mono: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        CASES, "this", {"faces": [painted("black", "right", "base")], "coating.albedo": (0.5,)}
    )
    spots = cells(scene_of_case("this")).spots.trace(
        HashedStream(dr.arange(mono.UInt32, LANES)), LANES
    )
    at = np.array(spots.p)[:, np.array(spots.others) > 0]
    assert at.shape[1] > 1000
    assert at[2].min() > 4.4


def test_each_direction_is_seen_from_all_pixels_of_a_target(mono: ModuleType) -> None:
    """Its cells do not depend on its place among the directions."""
    scene = scene_of_case("narrow 3 deg")
    phi = np.array([0.6, 1.2, 1.8, 2.4])
    found = []
    for seed, nodes in ((1, phi), (2, phi[::-1])):
        sampler = pad_cells(scene, np.tile(nodes, (scene.lamp_count, 1)), 0.0, False)
        run = MonteCarlo(sampler, 1024, REPLICATES, seed)
        run.sample(2)
        found.append(run.estimate())
    one, other = found[0], found[1][..., ::-1]
    bar = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / REPLICATES)
    z = (one.mean(axis=0) - other.mean(axis=0)) / bar
    assert np.sqrt((z**2).mean()) < 1.6
