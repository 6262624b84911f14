"""Cells of flat clear pads: lamps that are joined and lamps that are met, and all of them at once.

Absolute brightness is held against analog photons in ``tests/validation/test_clear_pads.py``.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.cell_sampler import CellSampler, Targets
from render.cells.clear.clear_cells import ClearCells
from render.reference import pad_cells
from render.sampling.monte_carlo import MonteCarlo
from render.scene import Scene, unchecked
from tests.oracles.pads import scene_of_case

PHI = 1.2
REPLICATES = 16


def cells(scene: Scene, indented: bool = False, nodes: int = 1) -> Any:
    # The last of three turns its back to the first.
    phi = np.full((scene.lamp_count, nodes), PHI) + 0.95 * np.arange(nodes)
    return pad_cells(scene, phi, 0.0, indented)


def sums(sampler: Any, lanes: int, passes: int, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return the light of each lamp over all targets, and its standard error."""
    run = MonteCarlo(sampler, lanes, REPLICATES, seed)
    run.sample(passes)
    found = run.estimate().reshape(REPLICATES, sampler.fibers, -1).sum(axis=2)
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(REPLICATES)


def agree(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> None:
    assert (np.abs(a[0] - b[0]) < 4.0 * np.hypot(a[1], b[1])).all()


@pytest.mark.parametrize("case", ["large lamp", "half below"])
def test_lamps_that_are_met_alone_have_the_light_of_lamps_that_are_joined_as_well(
    mono: ModuleType, case: str
) -> None:
    sampler = cells(scene_of_case(case))
    both = sums(sampler, 256, 1)
    sampler.ways.draws.chosen = 0.0 * sampler.ways.draws.chosen
    dr.make_opaque(sampler.ways.draws.chosen)
    met = sums(sampler, 32768, 1)
    assert (both[1] < 0.02 * both[0]).all()
    assert (met[1] < 0.1 * met[0]).all()
    agree(both, met)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["smooth", "white walls", "dome"])
@pytest.mark.parametrize("indented", [True, False])
def test_cells_are_those_of_one_lamp_after_the_other(
    mono: ModuleType, case: str, indented: bool
) -> None:
    scene = scene_of_case(case)
    together = cells(scene, indented)
    phi = np.full((scene.lamp_count, 1), PHI)
    apart = CellSampler(scene, phi, 0.0, indented, together.targets)
    assert isinstance(together, ClearCells)
    found, single = sums(together, 256, 2), sums(apart, 8192, 4)
    assert (single[1] < 0.02 * single[0]).all()
    agree(found, single)


def test_a_lamp_shines_the_same_beside_others_and_in_any_direction_node(mono: ModuleType) -> None:
    scene = scene_of_case("smooth")
    alone = unchecked(scene, {"fibers": unchecked(scene.fibers, {"tip": 0})})
    one, all_lit = sums(cells(alone), 256, 1), sums(cells(scene), 256, 1, seed=3)
    agree(one, (all_lit[0][:1], all_lit[1][:1]))
    run = MonteCarlo(cells(scene, nodes=3), 256, REPLICATES, 4)
    run.sample(1)
    nodes = run.estimate().reshape(REPLICATES, scene.lamp_count, -1, 3).sum(axis=2)[..., 0]
    agree(all_lit, (nodes.mean(axis=0), nodes.std(axis=0, ddof=1) / np.sqrt(REPLICATES)))


def test_an_interrupted_run_ends_bit_equal_and_parts_of_a_sample_are_independent(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    sampler = cells(scene_of_case("smooth"), indented=True)
    whole = MonteCarlo(sampler, 32, 4, 7)
    whole.sample(2)
    first = MonteCarlo(sampler, 32, 4, 7)
    first.sample(1)
    second = MonteCarlo(sampler, 32, 4, 7)
    second.restore(first.state())
    # Targets in several parts, as on pads with many of them.
    monkeypatch.setattr("render.cells.clear.clear_cells.MAX_VALUES", 32 * 4 * 2 * 5)
    second.sample(1)
    np.testing.assert_array_equal(whole.estimate(), second.estimate())
    np.testing.assert_array_equal(whole.largest(), second.largest())


def test_errors_of_lamps_that_share_camera_subpaths_are_in_their_replicates(
    mono: ModuleType,
) -> None:
    """The spread of colors over runs of other seeds is the one that replicates of a run state."""
    sampler = cells(scene_of_case("smooth"))
    runs = []
    for seed in range(24):
        run = MonteCarlo(sampler, 32, REPLICATES, seed)
        run.sample(1)
        # All lamps lit: (replicate, target).
        runs.append(run.estimate().reshape(REPLICATES, 2, -1).sum(axis=1))
    found = np.array(runs)
    stated = found.var(axis=1, ddof=1).mean(axis=0) / REPLICATES
    spread = found.mean(axis=1).var(axis=0, ddof=1)
    # Six targets of 23 degrees of freedom each.
    assert 0.6 < (spread / stated).mean() < 1.5


def test_targets_without_pixels_do_not_stop_a_run(mono: ModuleType) -> None:
    scene = scene_of_case("smooth")
    known = cells(scene).targets
    targets = Targets(known.pixel, np.append(known.offset, known.offset[-1]))
    sampler = ClearCells(scene, np.full((scene.lamp_count, 1), PHI), False, targets, 4)
    run = MonteCarlo(sampler, 16, 4, 1)
    run.sample(1)
    assert np.isfinite(run.estimate()).all()
