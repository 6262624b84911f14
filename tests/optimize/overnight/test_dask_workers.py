"""Renders on other processes: the answer of one process, whoever dies, hangs or joins meanwhile."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from optimize.overnight.dask_workers import DaskWorkers
from optimize.overnight.run_directory import RunError
from optimize.overnight.workers import LocalWorker
from render.errors import RenderError
from render.reference import RenderJob
from render.scene import Scene
from tests.optimize.overnight.tiny import tiny_jobs, tiny_scene

pytestmark = [
    pytest.mark.slow,
    # Distributed's own sockets and loops, closed by its threads a little later.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return tiny_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def jobs(scene: Scene) -> list[RenderJob]:
    return tiny_jobs(scene, 2)


@pytest.fixture(scope="module")
def alone(jobs: list[RenderJob]) -> list[np.ndarray]:
    """Return what one process renders."""
    done = LocalWorker().render(
        jobs, lambda job: Path("/nonexistent") / job.key, lambda count: None
    )
    return [entry.result.estimate for entry in done]


@pytest.fixture(scope="module")
def workers() -> Iterator[DaskWorkers]:
    """Two worker processes that may be silent for seconds only: a test has no minute to wait."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("optimize.overnight.dask_workers.WORKER_TTL", 8)
        made = DaskWorkers(workers=2)
    yield made
    made.close()


def rendered(
    workers: DaskWorkers, jobs: Sequence[RenderJob], meanwhile: Callable[[int], None] | None = None
) -> tuple[list[np.ndarray], list[str]]:
    """Return the results in order, and who made them; ``meanwhile`` is told of every arrival."""
    found: dict[int, np.ndarray] = {}
    names = []
    ticks: list[int] = []
    for done in workers.render(jobs, lambda job: Path(job.key), ticks.append):
        assert done.index not in found
        found[done.index] = done.result.estimate
        names.append(done.worker)
        if meanwhile is not None:
            meanwhile(len(found))
    assert sum(ticks) == sum(job.samples for job in jobs)
    return [found[index] for index in range(len(jobs))], names


def pids(workers: DaskWorkers) -> list[int]:
    return sorted(workers.client.run(os.getpid).values())


def assert_equal(found: list[np.ndarray], wanted: list[np.ndarray]) -> None:
    assert len(found) == len(wanted)
    for first, second in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(first, second)


def test_two_workers_give_the_answer_of_one_process(
    workers: DaskWorkers, jobs: list[RenderJob], alone: list[np.ndarray]
) -> None:
    found, names = rendered(workers, jobs)
    assert_equal(found, alone)
    assert len(set(names)) == 2
    assert workers.count == 2


def test_a_worker_that_is_killed_loses_nothing(
    workers: DaskWorkers, jobs: list[RenderJob], alone: list[np.ndarray]
) -> None:
    before = pids(workers)

    def kill(arrived: int) -> None:
        if arrived == 2:
            os.kill(before[0], signal.SIGKILL)

    found, _ = rendered(workers, jobs, kill)
    assert_equal(found, alone)
    deadline = time.monotonic() + 60
    while workers.count < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
    assert before[0] not in pids(workers)


def test_the_job_of_a_worker_that_hangs_is_given_to_another(
    workers: DaskWorkers, jobs: list[RenderJob], alone: list[np.ndarray]
) -> None:
    deadline = time.monotonic() + 60
    while workers.count < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
    asleep = pids(workers)[0]

    def stop(arrived: int) -> None:
        if arrived == 1:
            os.kill(asleep, signal.SIGSTOP)

    try:
        found, _ = rendered(workers, jobs, stop)
    finally:
        # Dask has ended it, unless this test fails.
        with suppress(ProcessLookupError):
            os.kill(asleep, signal.SIGCONT)
    assert_equal(found, alone)
    assert asleep not in pids(workers)


def test_a_notebook_whose_loop_runs_is_told_the_same() -> None:
    async def cell() -> None:
        with pytest.raises(RunError, match="no Dask scheduler answers at"):
            DaskWorkers(address="tcp://127.0.0.1:9")

    # Browsers of other tests may leave a loop that runs in this thread.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(cell())).result()


@pytest.mark.parametrize("how", ["tls", "tcp"])
def test_who_has_no_certificate_gives_workers_of_this_machine_no_work(
    workers: DaskWorkers, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setattr("optimize.overnight.dask_workers.CONNECT_SECONDS", 2.0)
    address = workers.cluster.scheduler_address
    assert address.startswith("tls://127.0.0.1:")
    with pytest.raises(RunError, match="no Dask scheduler answers at"):
        DaskWorkers(address=address.replace("tls", how))
    assert workers.count == 2


def test_a_cluster_at_an_address_is_used_and_workers_that_join_take_part(
    jobs: list[RenderJob],
) -> None:
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
    guest = DaskWorkers(address=cluster.scheduler_address)
    joined = threading.Thread(target=cluster.scale, args=(3,))
    try:
        _, names = rendered(guest, jobs, lambda arrived: joined.start() if arrived == 1 else None)
        joined.join()
        deadline = time.monotonic() + 60
        while guest.count < 3 and time.monotonic() < deadline:
            time.sleep(0.2)
        _, later = rendered(guest, jobs)
    finally:
        guest.close()
        cluster.close()
    assert len(set(later) | set(names)) >= 3


def test_a_worker_of_another_version_is_refused_instead_of_mixing_results(
    workers: DaskWorkers, jobs: list[RenderJob]
) -> None:
    foreign = replace(jobs[0], seed=77)
    # As if the worker had another Mitsuba: its key of the same job is another.
    foreign.__dict__["key"] = "0" * 64
    with pytest.raises(RenderError, match="another version of tactilux"):
        rendered(workers, [foreign])


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "quic://a:1", "tcp://"])
def test_an_address_without_a_scheduler_is_one_sentence(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.overnight.dask_workers.CONNECT_SECONDS", 2.0)
    began = time.monotonic()
    with pytest.raises(RunError, match="no Dask scheduler answers at") as caught:
        DaskWorkers(address=address)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 60
