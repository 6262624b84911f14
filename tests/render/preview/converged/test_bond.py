"""Light that is followed through a pad and a window of another index under it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from render.geometry import fresnel
from render.preview.bonded import with_bonded_window
from render.preview.converged import Effort, transport_at
from render.preview.converged.arrivals import Arrivals, arrivals, flown, receivers_at
from render.preview.converged.block import bent_block, patch_areas, patch_counts
from render.preview.converged.gathering import gathered, patch_points
from render.progress import Clock
from render.scene import Scene
from tests.oracles.mesh_cells import BentScene
from tests.oracles.pads import content_of_case, scene_of_case

AHEAD = np.array([np.pi / 2])
CASE = "window lit at its edges rough 0.05"


def arrived(scene: Scene, lamp: int, photons: int) -> Arrivals:
    blocks = bent_block(scene, 0.0, pressed=False), bent_block(scene, 0.0, pressed=True)
    receivers = receivers_at(scene, 0.0)
    brought = flown(scene, 0.0, lamp, AHEAD, *blocks, receivers, photons, range(photons))
    return arrivals(scene, brought).whole


def with_index(case: str, index: float) -> Scene:
    content = content_of_case(case)
    content["window"]["index"]["value"] = index
    return Scene.model_validate(content)


def test_upright_light_from_below_loses_what_two_faces_reflect() -> None:
    content = content_of_case("window lit from below")
    content["lamps"][0]["position"]["value"] = [0.0, 0.0, -9.0]
    content["lamps"][0]["direction"]["value"] = [0.0, 0.0, 1.0]
    content["lamps"][0]["profile"] = {"cosine_exponent": {"value": 100.0, "source": "a beam"}}
    scene = Scene.model_validate(content)
    power = np.pi * (arrived(scene, 0, 20_000).patches[:, 0] * patch_areas(scene)).sum()
    air, bond = ((1.6 - 1.0) / 2.6) ** 2, ((1.6 - 1.41) / 3.01) ** 2
    # What the bond reflects comes back from the lower face in part.
    passed = (1.0 - air) * (1.0 - bond) / (1.0 - air * bond)
    assert power == pytest.approx(passed, rel=0.003)


def test_what_the_faces_below_send_back_of_diffuse_light_is_what_an_endless_slab_sends() -> None:
    # Mirrors on all edges make the pad endless.
    content = content_of_case("window")
    content["window"]["index"]["value"] = 1.8
    scene = Scene.model_validate(content)
    block = bent_block(scene, 0.0, pressed=False)
    block.paint[:4] = 1.0, 1.0
    columns, rows = patch_counts(scene)
    parts = np.stack(
        [
            gathered(patch_points(scene, block, i, 2000), block, None, columns * rows).whole.patches
            for i in range(columns * rows)
        ]
    )
    cosine = np.sqrt((np.arange(4000) + 0.5) / 4000)
    bond, behind = fresnel(cosine, 1.8 / 1.41)
    lower, _ = fresnel(behind, 1.0 / 1.8)
    # To and fro between both faces (Stokes 1862).
    back = bond + (1.0 - bond) ** 2 * lower / (1.0 - bond * lower)
    assert parts.sum(axis=1).mean() == pytest.approx(back.mean(), abs=0.003)
    left = np.arange(columns * rows) % columns < columns // 2
    there, again = parts[left][:, ~left].sum(), parts[~left][:, left].sum()
    assert there == pytest.approx(again, rel=0.02)


def test_a_window_of_nearly_the_pads_index_is_more_of_the_pad() -> None:
    nearly, same = with_index(CASE, 1.410001), with_bonded_window(with_index(CASE, 1.41))
    sums = [
        [
            (arrived(scene, lamp, 60_000).patches[:, 0] * patch_areas(scene)).sum()
            for lamp in range(3)
        ]
        for scene in (nearly, same)
    ]
    np.testing.assert_allclose(*sums, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("case", [CASE, "window lit from below", "window of low index"])
def test_cells_through_a_window_are_those_of_analog_photons(case: str) -> None:
    scene = scene_of_case(case)
    found = transport_at(scene, 0.0, AHEAD, Effort(paths=2048, arrivals=2_000_000), Clock(1, None))
    for lamp in range(min(scene.lamp_count, 2)):
        for indented in (True, False):
            photons = BentScene(scene, 0.0, indented, views=2000)
            batches = photons.cells(lamp, float(AHEAD[0]), 400_000).replicates
            truth, se = batches.mean(axis=0).ravel(), stats.sem(batches, axis=0).ravel()
            cells = found.cells[lamp, 0, :, :-1] if indented else found.cells[lamp, 0, :, -1]
            cells = cells.ravel()
            noise = np.sqrt(se**2 + found.grain[lamp, 0] * truth)
            # Three percent more for light that is not quite alike within a pyramid.
            spread = float(stats.sem(batches.sum(axis=1)))
            assert cells.sum() == pytest.approx(truth.sum(), abs=3 * spread + 0.03 * truth.sum())
            error = (cells - truth) / np.hypot(noise, 0.03 * truth)
            assert np.sqrt(np.mean(error**2)) < 1.5
