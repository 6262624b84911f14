"""Which pads are rendered for all lamps at once, and which are refused."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.cells.choose_sampler import check_rendered, serves_all_lamps
from render.errors import RenderError
from render.reference import pad_cells, transport_jobs
from render.scene import Scene, load_scene
from tests.oracles.pads import (
    BELOW_THE_PAD,
    CASES,
    CAST_IN,
    REFUSED,
    painted,
    rough,
    scene_of_case,
    window,
)


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


@pytest.mark.parametrize("name", REFUSED)
def test_lamps_whose_light_is_trapped_between_walls_are_refused_by_name(name: str) -> None:
    scene = scene_of_case(name)
    with pytest.raises(RenderError, match=r"lamps cast into silicone between .*allowed:"):
        check_rendered(scene, [0.0])
    with pytest.raises(RenderError, match="does not render"):
        transport_jobs(scene, np.array([1.2]), np.zeros(1), samples=8, seeds=(1,))


def test_lamps_whose_light_leaves_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("cast in", "cast in rough 0.1", "cast into a rim rough 0.1", "cast in bent 45",
                 "cast in, black and mirror walls", "index 1.7"):  # fmt: skip
        scene = scene_of_case(name)
        check_rendered(scene, scene.bending.angles)
    one_black = [painted("black", "left", "tip")]
    check_rendered(case(monkeypatch, **CAST_IN, pad_index=(1.7,), faces=one_black), [0.0])
    check_rendered(scene_of_case("cast in index 1.7"), [0.5])


def test_mirrors_beside_a_bent_pad_still_face_each_other() -> None:
    scene = scene_of_case("cast in between mirrors")
    for bend in (0.02, 0.8):
        with pytest.raises(RenderError, match="the mirrors left and right"):
            check_rendered(scene, [bend])


def test_markov_chains_stay_with_one_lamp_at_a_time(mono: ModuleType) -> None:
    from render.cells.cell_sampler import CellSampler
    from render.cells.clear.clear_cells import ClearCells

    scene, phi = scene_of_case("smooth"), np.full((2, 1), 1.2)
    assert isinstance(pad_cells(scene, phi, 0.0, False), ClearCells)
    assert isinstance(pad_cells(scene, phi, 0.0, False, sampler="pssmlt"), CellSampler)
