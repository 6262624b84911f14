"""Workers of Dask.distributed: a cluster on this machine, or one that answers at an address.

Jobs are pure: a job that is rendered twice gives the same bits, so one that is lost is simply given
out again. Dask does that for workers that die. A worker that hangs answers nobody; when a job takes
far longer than it should, it is given to another worker as well and the first answer counts.
"""

from __future__ import annotations

import gc
import logging
import os
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optimize.overnight.run_directory import RunError
from optimize.overnight.workers import FinishedJob
from render.errors import RenderError, TactiluxError
from render.reference import RenderJob, RenderResult, run_job

CONNECT_SECONDS = 10.0
WORKER_TTL = 45
"""Seconds without a sign of life after which the scheduler restarts a worker of this machine."""
PATIENCE, SLOWER = 60.0, 6.0
"""A job is given out again after so many seconds, and so many times its expected time."""
UNKNOWN = 1800.0
"""The same, in seconds, while nothing is known of the workers' speed."""
ATTEMPTS = 5
"""How often a job may lose its worker before it is taken for the cause."""
_one_render = threading.Lock()


def render_remotely(text: str, key: str, threads: int | None) -> tuple[np.ndarray, float, str]:
    """Render a job in a worker: the estimate, its seconds, and whose they were.

    One at a time in a process, also where a worker has several threads.

    Raises:
        RenderError: this worker would render something else.
    """
    import drjit as dr

    job = RenderJob.from_json(text)
    if job.key != key:
        raise RenderError(
            "a worker has another version of tactilux, Mitsuba or Dr.Jit than this machine, so its "
            "results would differ: install the same ones there",
            field="dask",
        )
    with _one_render:
        if threads is not None:
            dr.set_thread_count(threads)
        result = run_job(job)
        gc.collect()
    return result.estimate, result.seconds, f"{socket.gethostname()}:{os.getpid()}"


@dataclass
class _Pending:
    """A job that is out: its index, attempts so far, and who has had it since when."""

    index: int
    job: RenderJob
    futures: list[Any] = field(default_factory=list)
    lost: int = 0
    seen: dict[str, float] = field(default_factory=dict)


def connect(address: str) -> Any:
    """Return a client of the scheduler at ``address`` (``tcp://host:8786``).

    The port is tried first: a client that never connects leaves threads and warnings behind.

    Raises:
        RunError: the address cannot be read, or no scheduler answers there.
    """
    from distributed import Client
    from distributed.comm.addressing import get_address_host_port

    try:
        host, port = get_address_host_port(address, strict=True)
        socket.create_connection((host, port), timeout=CONNECT_SECONDS).close()
        return Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise RunError(
            f"no Dask scheduler answers at {address}: start one with `dask scheduler`, or "
            "correct --dask (tcp://host:8786)",
            field="dask",
            value=address,
        ) from error


class DaskWorkers:
    """A client of a scheduler, and the cluster behind it where it was started here."""

    def __init__(self, *, workers: int | None = None, address: str | None = None) -> None:
        """Start ``workers`` processes here, or connect to the scheduler at ``address``.

        Raises:
            RunError: nothing answers at the address, or it has no workers.
        """
        import dask
        from distributed import Client, LocalCluster

        # What matters is said in sentences of our own.
        for name in ("distributed", "tornado", "bokeh"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.cluster: Any = None
        self.threads: int | None = None
        self.patience, self.unknown = PATIENCE, UNKNOWN
        self._rate: list[float] = []
        if address is None:
            count = workers or 1
            self.threads = max(1, len(os.sched_getaffinity(0)) // count)
            settings = {
                "distributed.scheduler.worker-ttl": f"{WORKER_TTL}s",
                "distributed.scheduler.allowed-failures": ATTEMPTS,
                "distributed.admin.low-level-log-length": 100,
                "distributed.worker.memory.terminate": False,
            }
            dask.config.set(settings)
            self.cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
            self.client = Client(self.cluster, set_as_default=False)
            return
        self.client = connect(address)

    @property
    def count(self) -> int:
        """Number of workers now."""
        return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))

    def render(
        self,
        jobs: Sequence[RenderJob],
        state: Callable[[RenderJob], Path],
        tick: Callable[[int], None],
    ) -> Iterator[FinishedJob]:
        """Yield the results as they come; unfinished jobs of a worker are not kept.

        No more jobs are out than there are workers: what waits behind a worker that hangs would
        wait with it.
        """
        arrived: queue.SimpleQueue[tuple[_Pending, Any]] = queue.SimpleQueue()
        later = [_Pending(index, job) for index, job in enumerate(jobs)][::-1]
        waiting: dict[int, _Pending] = {}
        looked = time.monotonic()
        try:
            while waiting or later:
                tick(0)
                while later and len(waiting) < self.count:
                    pending = later.pop()
                    waiting[pending.index] = pending
                    self._submit(pending, arrived)
                if time.monotonic() - looked > min(5.0, self.patience / 4):
                    looked = time.monotonic()
                    self._give_out_again(waiting, arrived)
                try:
                    pending, future = arrived.get(timeout=0.5)
                except queue.Empty:
                    continue
                if pending.index not in waiting:
                    continue  # another worker was faster
                done = self._result(pending, future, arrived)
                if done is not None:
                    del waiting[pending.index]
                    _cancel(pending)
                    tick(pending.job.samples)
                    yield done
        finally:
            for pending in waiting.values():
                _cancel(pending)

    def close(self) -> None:
        """Leave the scheduler; end what was started here."""
        self.client.close(timeout=5)
        if self.cluster is not None:
            self.cluster.close(timeout=5)

    def _submit(
        self,
        pending: _Pending,
        arrived: queue.SimpleQueue[tuple[_Pending, Any]],
        workers: Sequence[str] | None = None,
    ) -> None:
        job = pending.job
        future = self.client.submit(
            render_remotely,
            job.to_json(),
            job.key,
            self.threads,
            key=f"{job.name}-{len(pending.futures)}-{time.monotonic_ns()}",
            pure=False,
            workers=workers,
        )
        pending.futures.append(future)
        future.add_done_callback(lambda done: arrived.put((pending, done)))

    def _result(
        self, pending: _Pending, future: Any, arrived: queue.SimpleQueue[tuple[_Pending, Any]]
    ) -> FinishedJob | None:
        """Return what a future brings; None when its job had to be given out again."""
        from distributed import KilledWorker

        try:
            # The result still lies with its worker, which may hang or die before it is fetched.
            estimate, seconds, worker = future.result(timeout=self.patience)
        except TactiluxError:
            raise
        except TimeoutError:
            self._submit(pending, arrived, self._others(future))
            return None
        except KilledWorker as error:
            raise RenderError(
                f"{ATTEMPTS} workers died of the render {pending.job.name}: look at the memory of "
                "the machines, or render in one process without --workers and --dask",
                field="dask",
            ) from error
        except Exception as error:
            pending.lost += 1
            if pending.lost >= ATTEMPTS:
                raise RenderError(
                    f"the render {pending.job.name} failed on {ATTEMPTS} workers ({error}): check "
                    "that tactilux is installed there with its extra train",
                    field="dask",
                ) from error
            self._submit(pending, arrived)
            return None
        self._rate.append(seconds / pending.job.samples)
        return FinishedJob(pending.index, RenderResult(estimate, seconds), worker)

    def _others(self, future: Any) -> list[str] | None:
        """Return the workers that do not hold the result of ``future``, None if all do."""
        held: dict[str, Sequence[str]] = self.client.has_what()
        return [worker for worker, keys in held.items() if future.key not in keys] or None

    def _give_out_again(
        self, waiting: dict[int, _Pending], arrived: queue.SimpleQueue[tuple[_Pending, Any]]
    ) -> None:
        """Give jobs that take too long to workers that have not had them."""
        now = time.monotonic()
        processing: dict[str, Sequence[str]] = self.client.processing()
        by_key = {future.key: p for p in waiting.values() for future in p.futures}
        running: set[tuple[int, str]] = set()
        for worker, keys in processing.items():
            for key in keys:
                pending = by_key.get(key)
                if pending is not None:
                    pending.seen.setdefault(worker, now)
                    running.add((pending.index, worker))
        for pending in waiting.values():
            for worker in [w for w in pending.seen if (pending.index, w) not in running]:
                del pending.seen[worker]
            slow = [w for w, since in pending.seen.items() if now - since > self._limit(pending)]
            others = [worker for worker in processing if worker not in pending.seen]
            if slow and len(slow) == len(pending.seen) and others:
                self._submit(pending, arrived, others)

    def _limit(self, pending: _Pending) -> float:
        if not self._rate:
            return self.unknown
        expected = float(np.median(self._rate)) * pending.job.samples
        return max(self.patience, SLOWER * expected)


def _cancel(pending: _Pending) -> None:
    for future in pending.futures:
        future.cancel()
