"""Which pads are rendered for all lamps at once, and in how many passes."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from render.reference import pad_cells, transport_jobs
from render.reference.shared_lamps import STRATA, serves_all_lamps, shared_shape
from render.scene import Scene, load_scene
from tests.oracles.pads import BELOW_THE_PAD, CASES, painted, rough, scene_of_case, window


def case(monkeypatch: pytest.MonkeyPatch, **changes: object) -> Scene:
    monkeypatch.setitem(CASES, "this", {k.replace("_", "."): v for k, v in changes.items()})
    return scene_of_case("this")


def test_flat_clear_smooth_pads_are(monkeypatch: pytest.MonkeyPatch) -> None:
    assert serves_all_lamps(scene_of_case("smooth"), 0.0)
    for name in ("clear rim", "narrow", "below touching", "window"):
        assert serves_all_lamps(scene_of_case(name), 0.0), name
    assert serves_all_lamps(case(monkeypatch, faces=[painted("black", "base")]), 0.0)
    assert serves_all_lamps(case(monkeypatch, window=window(1.41), **BELOW_THE_PAD), 0.0)


def test_others_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not serves_all_lamps(scene_of_case("smooth"), 0.1)
    for name in ("rough 0.01", "no face", "rim", "window rough 0.1", "cast in", "row cast in"):
        assert not serves_all_lamps(scene_of_case(name), 0.0), name
    assert not serves_all_lamps(case(monkeypatch, faces=[rough(0.1, "base")]), 0.0)
    assert not serves_all_lamps(load_scene("finger20"), 0.0)


def test_replicates_have_the_same_samples_and_passes_the_same_paths() -> None:
    scene = scene_of_case("smooth")
    for samples in (1, 100, 5000, 400_000):
        lanes, passes = shared_shape(scene, samples, 8, None, indented=True)
        assert lanes % 8 == 0
        wanted = max(samples, STRATA * 8)
        assert STRATA * lanes * passes == pytest.approx(wanted, rel=0.35)
    lanes, passes = shared_shape(scene, 7 * 96, 8, 96, indented=True)
    assert (lanes, passes) == (24, 7)


def test_a_render_of_more_passes_goes_on_from_one_of_fewer_and_has_a_key_of_its_own() -> None:
    scene = scene_of_case("smooth")
    phi, bends = np.array([1.2]), np.zeros(1)
    few, many = (
        transport_jobs(scene, phi, bends, samples=n * 64, per_pass=64, seeds=(1,)) for n in (1, 3)
    )
    for one, other in zip(few, many, strict=True):
        assert one.chains == other.chains
        assert other.iterations == 3 * one.iterations
    assert few[0].key != replace(few[0], sampler="pssmlt").key


def test_markov_chains_stay_with_one_lamp_at_a_time(mono: ModuleType) -> None:
    from render.cells.cell_sampler import CellSampler
    from render.cells.clear.clear_cells import ClearCells

    scene, phi = scene_of_case("smooth"), np.full((2, 1), 1.2)
    assert isinstance(pad_cells(scene, phi, 0.0, False), ClearCells)
    assert isinstance(pad_cells(scene, phi, 0.0, False, sampler="pssmlt"), CellSampler)
