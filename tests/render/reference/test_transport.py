"""Rendered transport tables: shapes, error bars and resuming."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import render.reference.job
from render.errors import RenderError
from render.progress import Progress
from render.reference import TransportEstimate, render_transport
from render.scene import Scene, load_scene

PHI, BENDS = np.array([np.pi / 2]), np.array([0.0])
TINY: dict[str, Any] = {"samples": 4, "seeds": (1,), "replicates": 4}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def estimate(scene: Scene) -> TransportEstimate:
    return render_transport(scene, PHI, BENDS, **TINY)


def test_every_axis_of_the_estimate_is_where_the_table_wants_it(
    scene: Scene, estimate: TransportEstimate
) -> None:
    shape = (scene.lamp_count, 1, 1, scene.sites.count, scene.indenter.faces)
    assert estimate.T.shape == estimate.se.shape == shape
    assert estimate.background.shape == estimate.background_se.shape == shape[:-1]
    assert estimate.replicates.shape == (4, *shape)
    assert estimate.background_replicates.shape == (4, *shape[:-1])


def test_cells_are_positive_with_an_error_bar_unless_the_camera_cannot_see_them(
    estimate: TransportEstimate,
) -> None:
    seen = np.isfinite(estimate.T)
    assert seen.mean() > 0.9
    np.testing.assert_array_equal(seen, np.isfinite(estimate.se))
    assert (estimate.T[seen] >= 0).all()
    assert (estimate.T[seen] > 0).mean() > 0.95
    assert (estimate.se[seen & (estimate.T > 0)] > 0).all()
    assert (estimate.background > 0).all()


def test_the_estimate_is_the_mean_of_its_replicates(estimate: TransportEstimate) -> None:
    np.testing.assert_array_equal(estimate.T, estimate.replicates.mean(axis=0))
    assert estimate.seconds > 0
    assert estimate.settings["seeds"] == [1]


def test_a_fiber_lights_the_sites_near_it_most(scene: Scene, estimate: TransportEstimate) -> None:
    sites = estimate.background[:, 0, 0].reshape(-1, scene.sites.rows, scene.sites.columns)
    left, right = scene.fibers.left, scene.fibers.right
    assert sites[:left, :, 0].mean() > sites[:left, :, -1].mean()
    assert sites[-right:, :, -1].mean() > sites[-right:, :, 0].mean()


def test_an_interrupted_render_goes_on_and_ends_bit_equal_to_an_unbroken_one(
    scene: Scene, estimate: TransportEstimate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render.reference.job, "SAVE_SECONDS", 0.0)

    def stop(progress: Progress) -> None:
        if progress.done >= 0.3 * progress.total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_transport(scene, PHI, BENDS, **TINY, checkpoint=tmp_path, progress=stop)
    assert list(tmp_path.rglob("*.npz"))

    reports: list[Progress] = []
    resumed = render_transport(
        scene, PHI, BENDS, **TINY, checkpoint=tmp_path, progress=reports.append
    )
    assert reports[0].done > 0
    assert reports[-1].done == reports[-1].total
    np.testing.assert_array_equal(resumed.replicates, estimate.replicates)
    np.testing.assert_array_equal(resumed.background_replicates, estimate.background_replicates)
    np.testing.assert_array_equal(resumed.se, estimate.se)

    # A damaged file, as after a full disk: what was lost is rendered again.
    for path in tmp_path.rglob("*untouched*.npz"):
        path.write_bytes(path.read_bytes()[:100])
    mended = render_transport(scene, PHI, BENDS, **TINY, checkpoint=tmp_path)
    np.testing.assert_array_equal(mended.background_replicates, estimate.background_replicates)


@pytest.mark.parametrize(
    ("phi", "bends", "named"),
    [
        ([-0.1], [0.0], "phi"),
        ([np.nan], [0.0], "phi"),
        ([], [0.0], "phi"),
        ([[0.5]], [0.0], "phi"),
        ([0.5], [3.2], "bends"),
        ([0.5], [np.nan], "bends"),
        ([0.5], [], "bends"),
    ],
)
def test_directions_and_bends_out_of_range_are_named(
    scene: Scene, phi: list[Any], bends: list[float], named: str
) -> None:
    with pytest.raises(RenderError, match=named) as caught:
        render_transport(scene, np.array(phi), np.array(bends), **TINY)
    assert caught.value.field == named


@pytest.mark.parametrize("bad", [{"samples": 0}, {"seeds": ()}, {"seeds": (1, 1)}])
def test_settings_that_give_no_independent_runs_are_refused(
    scene: Scene, bad: dict[str, Any]
) -> None:
    with pytest.raises(RenderError, match=r"distinct seeds|samples = 0, allowed: .* at least 1"):
        render_transport(scene, PHI, BENDS, **{**TINY, **bad})
