"""The simulation of more workers: exact where the answer is known, bounded where it is not."""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optimize.overnight.result import ResultError
from optimize.overnight.scaling import (
    StageRenders,
    TransferCost,
    load_scaling,
    makespan,
    measure_transfer,
    planned_stages,
    scaling_of,
    simulated,
    write_scaling,
)
from tests.optimize.overnight.conftest import TinyNight

Run = Callable[..., Any]

FREE = TransferCost(0.0, 1e15, 1e15, 1e15)


def stage(name: str, *seconds: float, size: float = 1e6) -> StageRenders:
    return StageRenders(name, np.array(seconds), np.full(len(seconds), size))


@given(
    st.lists(st.floats(0.1, 100.0), min_size=1, max_size=40), st.integers(min_value=1, max_value=64)
)
def test_list_scheduling_keeps_grahams_bounds(seconds: list[float], workers: int) -> None:
    span = makespan(stage("table", *seconds), workers, FREE)
    ideal = max(sum(seconds) / workers, max(seconds))
    assert ideal * (1 - 1e-9) <= span <= (2 - 1 / workers) * ideal * (1 + 1e-9) + 1e-6


def test_equal_jobs_take_as_many_rounds_as_they_must() -> None:
    jobs = stage("table", *[10.0] * 17)
    assert [makespan(jobs, n, None) for n in (1, 2, 8, 64)] == [170.0, 90.0, 30.0, 10.0]


def test_results_that_come_home_at_once_wait_for_each_other() -> None:
    slow = TransferCost(0.5, 1e6, 1e6, 1e15)
    # Given out after 0.5 s, rendered in 10 s, then 0.5 + 1 + 1 s for each of eight results.
    assert makespan(stage("final", *[10.0] * 8), 8, slow) == pytest.approx(10.5 + 8 * 2.5)


def test_the_slower_of_loopback_and_network_counts() -> None:
    size = np.array([1e6])
    assert TransferCost(0.0, 1e8, 1e15, 1e6).handling(size)[0] == pytest.approx(1.0)
    assert TransferCost(0.0, 1e6, 1e15, 1e8).handling(size)[0] == pytest.approx(1.0)


def test_one_worker_takes_what_the_run_took() -> None:
    stages = [
        stage("table", *[10.0] * 20),
        stage("round 1", *[5.0] * 6),
        stage("final", *[4.0] * 30),
    ]
    found = simulated(stages, 500.0, 1, FREE)
    assert found.rows[0].seconds == pytest.approx(500.0)
    assert found.rows[0].speedup == found.rows[0].more == pytest.approx(1.0)
    assert found.serial_seconds == pytest.approx(500.0 - 350.0)
    # Twenty jobs on eight take three rounds, six on eight one, thirty on eight four.
    assert found.rows[2].seconds == pytest.approx(150.0 + 30.0 + 5.0 + 16.0)
    assert [row.more for row in found.rows] == pytest.approx([1.0, 2.0, 8.0, 64.0])


def test_a_run_of_several_workers_gives_the_time_of_one() -> None:
    stages = [stage("table", *[10.0] * 20)]
    found = simulated(stages, 150.0, 2, FREE)
    assert found.serial_seconds == pytest.approx(50.0)
    assert found.rows[0].seconds == pytest.approx(250.0)
    assert found.rows[1].seconds == pytest.approx(150.0)


def test_a_barrier_costs_what_the_longest_job_leaves_idle() -> None:
    apart = [stage("table", 9.0, 1.0), stage("final", 1.0, 9.0)]
    found = simulated(apart, 20.0, 1, FREE)
    assert found.rows[1].seconds == pytest.approx(18.0)


def test_a_planned_night_keeps_the_shares_of_its_stages() -> None:
    planned = planned_stages([stage("table", 1.0, 3.0)], 8.0)
    spent = {part.name: part.seconds.sum() / 28800 for part in planned}
    assert spent["table"] == pytest.approx(0.40)
    assert spent["final"] == pytest.approx(0.24)
    assert sum(spent.values()) == pytest.approx(0.88)
    # 128 renders of about 90 s, as uneven as the measured ones.
    assert len(planned[0].seconds) == 128
    assert planned[0].seconds.mean() == pytest.approx(90.0)
    assert planned[0].seconds.max() == pytest.approx(3 * planned[0].seconds.min())
    found = simulated(planned, 28800, 1, FREE)
    assert found.serial_seconds == pytest.approx(0.12 * 28800)


def test_what_the_disk_cannot_keep_no_worker_can_speed_up() -> None:
    slow = replace(FREE, store=1e5)
    found = simulated([stage("table", *[10.0] * 100)], 1000.0, 1, slow)
    # Each result takes 10 s to keep: 64 workers are as slow as one.
    assert found.rows[-1].seconds == pytest.approx(1010.0, rel=0.01)
    assert found.rows[-1].more == pytest.approx(1.0)


# In a process of its own: a cluster leaves warnings behind that are its own affair.
DASK = """
import json, sys, time
from distributed import Client, LocalCluster
seconds = json.loads(sys.argv[1])
with LocalCluster(n_workers=4, threads_per_worker=1, processes=False, dashboard_address=":0") as c:
    with Client(c) as client:
        client.submit(time.sleep, 0.0, pure=False).result()
        began = time.monotonic()
        client.gather([client.submit(time.sleep, s, pure=False) for s in seconds])
        print(time.monotonic() - began)
"""


def test_dask_needs_the_time_that_is_simulated() -> None:
    seconds = np.random.default_rng(1).uniform(0.2, 0.8, 24)
    words = [sys.executable, "-c", DASK, json.dumps(seconds.tolist())]
    spent = float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    found = makespan(stage("table", *seconds), 4, FREE)
    # Sleeping needs no core, so a busy machine delays little; one worker would take four times it.
    assert 0.95 * found < spent < 2.0 * found


def test_transfer_is_measured_on_this_machine(tmp_path: Path) -> None:
    found = measure_transfer(tmp_path, 4_000_000)
    assert 0.0 < found.latency < 0.5
    assert 1e6 < found.rate < 1e12
    assert 1e5 < found.store < 1e12
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return a directory with the record of five renders, one of them made twice."""
    (tmp_path / "renders").mkdir()
    with sqlite3.connect(tmp_path / "run.sqlite") as db:
        db.executescript(
            "CREATE TABLE evaluations (id INTEGER PRIMARY KEY, key TEXT, kind TEXT, seconds REAL, "
            "worker TEXT); CREATE TABLE attempts (id INTEGER PRIMARY KEY, seconds REAL);"
        )
        rows = [
            ("t", "1/trial", 1.0),
            ("a", "1/table", 99.0),
            ("b", "1/table", 2.0),
            ("a", "1/table", 3.0),
        ]
        rows += [("c", "1/round 1", 4.0), ("d", "1/final", 5.0), ("e", "1/final", 6.0)]
        for key, kind, seconds in rows:
            db.execute(
                "INSERT INTO evaluations (key, kind, seconds, worker) VALUES (?, ?, ?, 'here')",
                (key, kind, seconds),
            )
            (tmp_path / "renders" / f"{key}.npz").write_bytes(bytes(1000))
        db.executemany("INSERT INTO attempts (seconds) VALUES (?)", [(20.0,), (10.0,)])
    db.close()
    return tmp_path


def test_the_record_of_a_run_is_what_it_is_simulated_from(run: Path) -> None:
    found = scaling_of(run, run)
    assert (found.renders, found.render_seconds) == (5, 20.0)
    assert found.serial_seconds == pytest.approx(10.0)
    assert found.rows[0].seconds == pytest.approx(30.0)
    # The longest of each stage: 3, 4 and 6 s.
    assert found.rows[1].seconds == pytest.approx(10.0 + 13.0, abs=0.5)
    assert found.measured_workers == 1
    assert found.size == 1000


def test_what_was_simulated_is_kept_and_read_again(run: Path) -> None:
    assert load_scaling(run) is None
    kept = write_scaling(run)
    assert load_scaling(run) == kept


@pytest.mark.parametrize("content", ["", "{}", '{"rows": 3}'])
def test_a_damaged_file_is_refused(run: Path, content: str) -> None:
    write_scaling(run)
    (run / "scaling.json").write_text(content)
    with pytest.raises(ResultError, match=r"scaling\.json is damaged"):
        load_scaling(run)


def test_a_real_run_tells_what_more_workers_would_do(
    tactilux: Run, tiny_night: TinyNight, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(tiny_night.run, folder)
    (folder / "scaling.json").unlink()
    done = tactilux("status", folder, "--scaling", "--json")
    assert done.code == 0, done.err
    status = json.loads(done.out)
    found = status["scaling"]
    assert [row["workers"] for row in found["rows"]] == [1, 2, 8, 64]
    assert found["renders"] == status["evaluations"]
    assert found["rows"][0]["seconds"] == pytest.approx(status["seconds"])
    assert found["rows"][-1]["seconds"] >= found["serial_seconds"] + found["longest"]
    assert not (folder / "scaling.json").exists()
    planned = tactilux("status", folder, "--scaling", "--hours", 8)
    assert "the plan of a night of 8 h" in " ".join(planned.out.split())
    assert tactilux("status", folder, "--hours", 8).code == 2
    said = " ".join(tactilux("status", folder, "--scaling").out.split())
    assert f"Simulated from this night's {found['renders']} renders" in said


def test_a_run_without_renders_says_so(run: Path, tmp_path: Path) -> None:
    with sqlite3.connect(run / "run.sqlite") as db:
        db.execute("DELETE FROM evaluations")
    db.close()
    with pytest.raises(ResultError, match="no renders"):
        scaling_of(run, run)
    with pytest.raises(ResultError, match="cannot be read"):
        scaling_of(tmp_path / "none", tmp_path)
