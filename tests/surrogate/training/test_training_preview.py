"""The preview that a model is trained on is converged where time allows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from render.finished_parts import FinishedParts
from render.preview.converged import (
    ConvergedTransport,
    Effort,
    cache,
    converged_transport,
)
from render.progress import Clock, Progress
from render.scene import Scene
from surrogate.model.converged_grid import corrected
from surrogate.model.preview_grid import InterpolationError, PreviewGrid, draw_grid
from surrogate.training import training_preview
from surrogate.training.training_preview import TrainingPreview, followed_grid
from tests.small_scenes import small_scene


@pytest.fixture(scope="module")
def flat() -> Scene:
    return small_scene(bending={"angles": {"value": [0.0], "unit": "deg", "source": "flat"}})


@pytest.fixture(scope="module")
def drawn(flat: Scene) -> PreviewGrid:
    return draw_grid(flat, 5, 1)


@pytest.fixture(autouse=True)
def _little_effort(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "EFFORT", Effort(photons=2000, paths=128, arrivals=20_000))


def test_light_is_followed_to_every_facet(flat: Scene, drawn: PreviewGrid) -> None:
    found = followed_grid(drawn, flat, None, None)
    wanted = corrected(drawn, flat, converged_transport(flat))
    np.testing.assert_array_equal(found.log_transport, wanted.log_transport)
    assert not np.array_equal(found.log_transport, drawn.log_transport)


def test_where_that_takes_too_long_the_drawn_preview_stays_and_says_so(
    flat: Scene, drawn: PreviewGrid
) -> None:
    told: list[Progress] = []
    assert followed_grid(drawn, flat, 1e-3, told.append) is drawn
    assert "the preview stays as the shader draws it" in told[-1].note
    # What was followed before costs nothing.
    converged_transport(flat)
    assert followed_grid(drawn, flat, 1e-3, None) is not drawn


def test_what_is_compiled_before_the_first_light_is_no_measure_of_the_rest(
    flat: Scene, drawn: PreviewGrid, monkeypatch: pytest.MonkeyPatch
) -> None:
    transport = converged_transport(flat)

    def slow_at_first(
        scene: Scene, goal: float, told: Callable[[Progress], None]
    ) -> Iterator[ConvergedTransport]:
        for noise in (0.05, 0.04):
            clock = Clock(100, told)
            time.sleep(0.5)
            for _ in range(100):
                clock.tick()
            yield transport._replace(noise=np.array([noise]))

    monkeypatch.setattr(training_preview, "refinements", slow_at_first)
    # By the first hundredth alone, or from the begin of the first run on, it would take 50 s.
    assert followed_grid(drawn, flat, 2.0, None).photon_noise == 0.04


def test_time_that_is_left_goes_to_more_light_paths_and_is_said(
    flat: Scene, drawn: PreviewGrid, monkeypatch: pytest.MonkeyPatch
) -> None:
    once = followed_grid(drawn, flat, None, None)
    assert once.photon_noise is not None
    goal = 0.9 * once.photon_noise
    monkeypatch.setattr(training_preview, "NOISE_GOAL", goal)
    told: list[Progress] = []
    found = followed_grid(drawn, flat, 3600.0, told.append)
    assert found.photon_noise is not None
    assert found.photon_noise <= goal
    assert not np.array_equal(found.log_transport, once.log_transport)
    said = f"photon noise of {found.photon_noise:.1%} of a color, {once.photon_noise:.1%} before."
    assert told[-1].note.endswith(said)
    # Where no time is left it is as it was, whatever is wanted.
    monkeypatch.setattr(training_preview, "NOISE_GOAL", 1e-9)
    np.testing.assert_array_equal(
        followed_grid(drawn, flat, 1e-3, None).log_transport, found.log_transport
    )


def test_it_is_kept_with_its_kind_and_its_noise(drawn: PreviewGrid, tmp_path: Path) -> None:
    parts, error = FinishedParts(tmp_path, "key"), InterpolationError(0.1, 0.2, 0.3)
    for converged, noise in ((False, None), (True, 0.017)):
        grid = replace(drawn, photon_noise=noise)
        TrainingPreview(grid, error, None, converged, gave_up=2.5).save(parts)
        kept = TrainingPreview.load(parts, None)
        assert kept is not None
        assert (kept.error, kept.left_out, kept.converged) == (error, None, converged)
        np.testing.assert_array_equal(kept.grid.log_transport, drawn.log_transport)
        assert (kept.grid.photon_noise, kept.gave_up) == (noise, 2.5)
    assert TrainingPreview.load(FinishedParts(tmp_path, "other"), None) is None
