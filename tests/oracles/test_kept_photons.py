"""Photons that are kept are those that the oracle still tells, of the scenes that cases have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.long import LONG
from tests.oracles import kept_photons
from tests.oracles.kept_photons import WHOLE, analog, median_error, photons_kept, traced
from tests.oracles.pads import CASES, scene_of_case

TRACED_AGAIN = ("smooth", "thin rim", "cast in bent 45", "window", "lobe", "random 4")


@pytest.mark.parametrize("case", WHOLE if LONG else TRACED_AGAIN)
def test_the_oracle_says_again_what_is_kept(case: str) -> None:
    scene = scene_of_case(case)
    for pressed in (True, False):
        kept = photons_kept(case, pressed)
        again = traced(analog(scene, pressed, seed=3), 160_000)
        difference = again.mean(axis=0) - kept.mean(axis=0)
        z = difference / np.hypot(stats.sem(again), stats.sem(kept))
        # Where few photons arrive, their spread says little of the error.
        known = stats.sem(again) < 0.3 * again.mean(axis=0)
        assert (np.abs(z[known]) < 6.0).all()
        lamps = again.sum(axis=-1) - kept.sum(axis=-1).mean(axis=0)
        assert (np.abs(lamps.mean(axis=0)) < 5.0 * stats.sem(lamps)).all()


def test_what_is_missing_or_of_another_scene_is_traced_and_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(kept_photons, "KEPT", tmp_path)
    monkeypatch.setattr(kept_photons, "PILOT", 1600)
    monkeypatch.setattr(kept_photons, "LEAST", 16_000)
    monkeypatch.setattr(kept_photons, "MOST", 16_000)
    first = photons_kept("smooth", pressed=False)
    assert first.shape == (16, 2, 6)
    assert [file.name for file in tmp_path.iterdir()] == ["smooth.npz"]
    assert median_error(first) < 0.3
    assert (photons_kept("smooth", pressed=False) == first).all()
    monkeypatch.setitem(CASES, "smooth", {"coating.albedo": (0.25,)})
    assert 0.4 < photons_kept("smooth", pressed=False).sum() / first.sum() < 0.6
