"""What more workers would do is a bound from the run's own record."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.overnight.run_directory import RECORD, RunError
from optimize.overnight.status import scaling_of
from optimize.overnight.store import Store
from render.reference import RenderResult
from tests.optimize.overnight.conftest import TinyNight
from tests.optimize.overnight.tiny import request_of, tiny_jobs, tiny_scene

Run = Callable[..., Any]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return a run of 30 s: four renders of the table, two trial renders, one final one."""
    scene, run = tiny_scene(tmp_path), tmp_path / "run"
    run.mkdir()
    store = Store(run, request_of(scene), print)
    jobs = tiny_jobs(scene, 4)
    kinds = ["1/trial"] * 2 + ["1/table"] * 4 + ["1/final"]
    for job, kind, seconds in zip(jobs, kinds, (1.0, 1.0, 2.0, 2.0, 2.0, 6.0, 5.0), strict=False):
        store.keep(job, RenderResult(np.zeros(1), np.zeros(1), seconds), kind, "here")
    # Whatever this machine took to keep them.
    store._began = time.monotonic() - 30.0
    store.close("stopped")
    return run


def test_one_worker_takes_what_the_run_took_and_many_the_longest_render_of_each_stage(
    run: Path,
) -> None:
    found = scaling_of(run)
    # 17 s of renders that can be shared, 13 s of everything else.
    assert found[1] == pytest.approx(30.0, abs=0.5)
    assert found[2] == pytest.approx(13.0 + 6.0 + 5.0, abs=0.5)
    assert found[64] == pytest.approx(13.0 + 6.0 + 5.0, abs=0.5)


def test_a_render_that_was_made_again_counts_once(run: Path, tmp_path: Path) -> None:
    before = scaling_of(run)
    scene = tiny_scene(tmp_path)
    store = Store(run, request_of(scene), print)
    again = tiny_jobs(scene, 4)[2]
    store.keep(again, RenderResult(np.zeros(1), np.zeros(1), 2.0), "1/table", "here")
    store.close("stopped")
    assert scaling_of(run)[1] == pytest.approx(before[1], abs=0.5)


def test_a_place_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=f"holds no run \\({RECORD}\\)"):
        scaling_of(tmp_path)


@pytest.mark.slow
def test_a_real_run_tells_what_more_workers_would_do(tactilux: Run, tiny_night: TinyNight) -> None:
    done = tactilux("status", tiny_night.run, "--scaling", "--json")
    assert done.code == 0, done.err
    status = json.loads(done.out)
    seconds = status["scaling"]
    assert list(seconds) == ["1", "2", "8", "64"]
    assert seconds["1"] == pytest.approx(status["seconds"], rel=0.05)
    assert seconds["64"] <= seconds["8"] <= seconds["2"] <= seconds["1"]
    said = " ".join(tactilux("status", tiny_night.run, "--scaling").out.split())
    assert "other work does not shrink" in said
