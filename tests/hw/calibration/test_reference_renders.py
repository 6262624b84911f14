"""Renders for all rigs of a design are made once, and interrupted work goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hw.calibration.pad_light import MaterialRender, PadLight, reference_renders
from hw.calibration.reference_lines import Setup
from render.progress import Progress
from render.scene import Scene, unchecked
from tests.hw.calibration.toy import SPACE

PHI = np.full(20, np.pi / 2)
BENDS = np.array([0.0])
LIT = [[3, 8]]


class Renderer:
    """Notes what it is asked for; stops as if killed after some renders."""

    def __init__(self, patience: int = 1000) -> None:
        self.asked: list[tuple[float, int]] = []
        self._patience = patience

    def __call__(self, setup: Setup, *_: object, seed: int, **__: object) -> PadLight:
        if len(self.asked) == self._patience:
            raise KeyboardInterrupt
        scattering = float(SPACE.of(setup.scene)[0])
        self.asked.append((scattering, seed))
        light = np.full((1, 20, 4, 4), scattering)
        return PadLight(2.0, 4, light, 0.1 * light)


def renders(scene: Scene, folder: Path, renderer: Renderer, **other: Any) -> list[MaterialRender]:
    options = {"lit": LIT, "samples": 10, "materials": 4} | other
    lit = options.pop("lit")
    setup = Setup(scene, PHI, BENDS)
    return reference_renders(setup, lit, folder=folder, render=renderer, **options)


def test_every_material_is_rendered_with_a_seed_of_its_own(scene: Scene, tmp_path: Path) -> None:
    renderer = Renderer()
    found = renders(scene, tmp_path, renderer)
    np.testing.assert_array_equal([one.material for one in found], SPACE.sobol(4))
    np.testing.assert_allclose([one for one, _ in renderer.asked], SPACE.sobol(4)[:, 0])
    assert len({seed for _, seed in renderer.asked}) == 4


def test_another_rig_of_the_design_renders_nothing(scene: Scene, tmp_path: Path) -> None:
    first = renders(scene, tmp_path, Renderer())
    other = unchecked(scene, {"name": "mine"})
    again = renders(other, tmp_path, Renderer(patience=0))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.light.radiance, two.light.radiance)


def test_killed_it_goes_on_where_it_stood(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        renders(scene, tmp_path, Renderer(patience=2))
    rest = Renderer()
    renders(scene, tmp_path, rest)
    assert len(rest.asked) == 2


def test_more_materials_keep_those_that_there_are(scene: Scene, tmp_path: Path) -> None:
    renders(scene, tmp_path, Renderer(), materials=4)
    more = Renderer()
    found = renders(scene, tmp_path, more, materials=9)
    assert len(more.asked) == 5
    np.testing.assert_array_equal([one.material for one in found], SPACE.sobol(9))


def test_the_time_left_is_that_of_all_renders(scene: Scene, tmp_path: Path) -> None:
    told: list[Progress] = []

    def slow(*args: Any, progress: Callable[[Progress], None], **options: Any) -> PadLight:
        progress(Progress(5, 10, 2.0, 2.0))
        return Renderer()(*args, **options)

    reference_renders(
        Setup(scene, PHI, BENDS), LIT, materials=3, samples=10, folder=tmp_path, render=slow,
        progress=told.append,
    )  # fmt: skip
    assert [at.stage for at in told] == [f"material {n} of 3" for n in (1, 2, 3)]
    assert [at.eta_seconds for at in told] == [10.0, 6.0, 2.0]
    assert [(at.done, at.total) for at in told] == [(5, 30), (15, 30), (25, 30)]


def test_a_damaged_file_is_rendered_again(scene: Scene, tmp_path: Path) -> None:
    renders(scene, tmp_path, Renderer())
    one = sorted(tmp_path.rglob("*.npz"))[1]
    one.write_bytes(one.read_bytes()[:200])
    again = Renderer()
    renders(scene, tmp_path, again)
    assert len(again.asked) == 1


@pytest.mark.parametrize("other", [{"samples": 20}, {"lit": [[3, 9]]}])
def test_other_paths_or_fibers_are_other_renders(
    scene: Scene, tmp_path: Path, other: dict[str, Any]
) -> None:
    renders(scene, tmp_path, Renderer())
    fresh = Renderer()
    renders(scene, tmp_path, fresh, **other)
    assert len(fresh.asked) == 4
