"""A finished night that is asked for more hours goes on from what it knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.overnight.job import REFINE_FACTOR, OvernightConfig, overnight
from optimize.overnight.result import OvernightResult
from optimize.overnight.status import status_of
from optimize.overnight.workers import LocalWorker
from tests.optimize.overnight.tiny import rows, write_tiny

SECONDS = 12.0


def batches(run: Path) -> list[str]:
    named = "SELECT name FROM decisions WHERE name LIKE '%/final batch%' AND value != '[]'"
    return [str(name) for (name,) in rows(run, named)]


def test_some_more_hours_verify_the_same_finalists_with_more_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Drawing a report takes seconds, and nobody reads it here.
    monkeypatch.setattr("optimize.overnight.job.write_report", lambda night, run: None)
    scene, run = write_tiny(tmp_path), tmp_path / "run"

    def night(seconds: float) -> OvernightResult:
        return overnight(
            str(scene), run, OvernightConfig(hours=seconds / 3600), make_workers=LocalWorker
        )

    first = night(SECONDS)
    kept = batches(run)
    # Nothing to do: the same answer, at once.
    assert night(SECONDS).finalists[0].score == first.finalists[0].score
    assert batches(run) == kept

    more = night(0.5 * (1 + REFINE_FACTOR) * status_of(run).seconds)
    for before, after in zip(first.finalists, more.finalists, strict=True):
        np.testing.assert_allclose(after.design.phi, before.design.phi)
    added = batches(run)[len(kept) :]
    assert added
    assert all("extension 1" in name for name in added)
    assert more.replicates > first.replicates
