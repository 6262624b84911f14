"""Models and renders of several shots are those of one picture, shot by shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.design import Design, baseline_design, load_design, save_design
from optimize.scoring import open_model, predicted_colors
from render.reference import render_image
from render.scene import Scene, load_scene

SEED = 5


@pytest.fixture(scope="module")
def scenes() -> tuple[Scene, Scene]:
    one = load_scene("digit").with_(sites_columns=2, sites_rows=2)
    return one, one.with_(camera_shots=2)


def designs_of(one: Scene, two: Scene) -> tuple[Design, tuple[Design, ...]]:
    """Return a design of two shots, and that of each of them alone."""
    colors = [two.palette.index(name) for name in ("red@1", "green", "blue@2")]
    design = Design.of_colors(np.full(3, np.pi / 2), colors, two.palette)
    shots = two.palette.in_shots(design.drive)
    return design, tuple(Design(design.phi, drive, one.palette) for drive in shots)


def test_a_model_of_two_shots_sees_in_each_what_a_model_of_one_sees(
    scenes: tuple[Scene, Scene],
) -> None:
    one, two = scenes
    model, shots = open_model(one, coarse=True), open_model(two, coarse=True)
    assert shots.metadata.channels == [*two.palette.channels]
    assert shots.exposure == pytest.approx(model.exposure, rel=1e-6)
    design, alone = designs_of(one, two)
    seen = np.split(predicted_colors(shots, design), 2, axis=-1)
    for found, single in zip(seen, alone, strict=True):
        expected = predicted_colors(model, single)
        assert np.allclose(found, expected, rtol=1e-5, atol=1e-5 * expected.max())
    # What shines in all shots is one picture, taken twice.
    twice = np.split(predicted_colors(shots, baseline_design(two)), 2, axis=-1)
    assert np.array_equal(twice[0], twice[1])


def test_design_files_keep_the_shots(scenes: tuple[Scene, Scene], tmp_path: Path) -> None:
    one, two = scenes
    design, _ = designs_of(one, two)
    save_design(tmp_path / "design.json", design, two)
    again = load_design(tmp_path / "design.json", two)
    assert again.color_names == ["red@1", "green", "blue@2"]
    assert again.palette == design.palette
    assert np.array_equal(again.drive, design.drive)


@pytest.mark.slow
def test_a_render_of_two_shots_is_the_sum_of_the_lamps_of_each(
    scenes: tuple[Scene, Scene],
) -> None:
    one, two = scenes
    design, alone = designs_of(one, two)
    size = {"width": 24, "height": 18, "samples": 64, "seed": SEED}
    picture = render_image(two, design.phi, design.power, 0.0, **size).radiance
    assert picture.shape == (18, 24, 6)
    for number, shot in enumerate(alone):
        seen = picture[..., 3 * number : 3 * number + 3]
        lamps = sum(
            render_image(one, shot.phi, np.where(np.arange(3)[:, None] == lamp, shot.power, 0.0),
                         0.0, **size).radiance
            for lamp in np.flatnonzero(shot.drive.any(axis=1)).tolist()
        )  # fmt: skip
        lit = shot.power.any(axis=0)
        assert (seen[..., ~lit] == 0.0).all()
        ratio = seen.mean(axis=(0, 1))[lit] / lamps.mean(axis=(0, 1))[lit]
        # Light paths of other numbers of lamps are other paths.
        assert ratio == pytest.approx(1.0, abs=0.12)
