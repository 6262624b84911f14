"""Workers of Dask.distributed: a cluster on this machine, or one that answers at an address.

Jobs are pure: a job that is rendered twice gives the same bits, so one that is lost is simply given
out again. Dask does that: for workers that die, and for those that fall silent (stopped, swapped
out, cut off), which its scheduler restarts after ``distributed.scheduler.worker-ttl``, 5 minutes
unless its owner says otherwise.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import queue
import socket
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from optimize.overnight.run_directory import RunError
from optimize.overnight.workers import FinishedJob, State, Tick
from render.errors import RenderError, TactiluxError
from render.reference import RenderJob, RenderResult, run_job

CONNECT_SECONDS = 10.0
WORKER_TTL = 45
"""Seconds without a sign of life after which a worker of this machine is restarted."""
ATTEMPTS = 5
"""How often a job may lose its worker, or fail on it, before it is taken for the cause."""
_one_render = threading.Lock()


def render_remotely(text: str, key: str, threads: int | None) -> tuple[dict[str, np.ndarray], str]:
    """Render a job in a worker: the arrays of its result, and whose they were.

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
    return result.arrays(), f"{socket.gethostname()}:{os.getpid()}"


def connect(address: str) -> Any:
    """Return a client of the scheduler at ``address`` (``tcp://host:8786``).

    Certificates for ``tls://`` are those of Dask's own settings (``distributed.comm.tls``).

    A connection is tried first, with its handshake: a client that never connects leaves threads and
    warnings behind, and on a busy machine may wait for ever.

    Raises:
        RunError: the address cannot be read, or no scheduler answers there.
    """
    from distributed import Client, Security
    from distributed.comm import connect as opened
    from distributed.comm.addressing import get_address_host_port

    async def tried() -> None:
        security = Security().get_connection_args("client")
        async with asyncio.timeout(2.0 * CONNECT_SECONDS):
            comm = await opened(address, timeout=CONNECT_SECONDS, **security)
            await comm.close()

    try:
        host, port = get_address_host_port(address, strict=True)
        # A port that is refused says so at once; a handshake is tried for as long as it may take.
        socket.create_connection((host, port), timeout=CONNECT_SECONDS).close()
        # A thread of its own: in a notebook this one runs a loop already.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(lambda: asyncio.run(tried())).result()
        return Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise RunError(
            f"no Dask scheduler answers at {address}: start one with `dask scheduler`, or "
            "correct --dask (tcp://host:8786)",
            field="dask",
        ) from error


class DaskWorkers:
    """A client of a scheduler, and the cluster behind it where it was started here."""

    def __init__(self, *, workers: int | None = None, address: str | None = None) -> None:
        """Start ``workers`` processes here, or connect to the scheduler at ``address``.

        Raises:
            RunError: nothing answers at the address.
        """
        import dask
        from distributed import Client, LocalCluster, Security

        # What matters is said in sentences of our own.
        for name in ("distributed", "tornado", "bokeh"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.cluster: Any = None
        self.threads: int | None = None
        if address is not None:
            self.client = connect(address)
            return
        count = workers or 1
        self.threads = max(1, len(os.sched_getaffinity(0)) // count)
        dask.config.set(
            {
                "distributed.scheduler.worker-ttl": f"{WORKER_TTL}s",
                "distributed.scheduler.allowed-failures": ATTEMPTS,
                "distributed.admin.low-level-log-length": 100,
                "distributed.worker.memory.terminate": False,
            }
        )
        self.cluster = LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            # Whoever may give work to a scheduler runs code as its owner: other users of this
            # machine lack the certificate, which is in memory alone.
            security=Security.temporary(),
            silence_logs=logging.CRITICAL,
        )
        self.client = Client(self.cluster, set_as_default=False)

    @property
    def count(self) -> int:
        """Number of workers now."""
        return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))

    def render(self, jobs: Sequence[RenderJob], _state: State, tick: Tick) -> Iterator[FinishedJob]:
        """Yield the results as they come; unfinished jobs of a worker are not kept."""
        arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        out: dict[str, int] = {}
        futures = []
        try:
            for index, job in enumerate(jobs):
                words = job.to_json(), job.key, self.threads
                futures.append(
                    self.client.submit(render_remotely, *words, pure=False, retries=ATTEMPTS - 1)
                )
                out[futures[-1].key] = index
                futures[-1].add_done_callback(arrived.put)
            while out:
                tick(0)
                try:
                    future = arrived.get(timeout=0.5)
                    job = jobs[out[future.key]]
                    # It still lies with its worker, which may die or fall silent: then ask again.
                    arrays, worker = _result(future, job)
                except queue.Empty:
                    continue
                except TimeoutError:
                    arrived.put(future)
                    continue
                tick(job.samples)
                yield FinishedJob(out.pop(future.key), RenderResult.of(arrays), worker)
        finally:
            for future in futures:
                future.cancel()

    def close(self) -> None:
        """Leave the scheduler; end what was started here."""
        self.client.close(timeout=5)
        if self.cluster is not None:
            self.cluster.close(timeout=5)


def _result(future: Any, job: RenderJob) -> tuple[dict[str, np.ndarray], str]:
    """Return what a finished future brings, within a second."""
    try:
        found: tuple[dict[str, np.ndarray], str] = future.result(timeout=1.0)
    except (TactiluxError, TimeoutError):
        raise
    except Exception as error:
        raise RenderError(
            f"the render {job.name} was lost on {ATTEMPTS} workers ({error}): look at the memory "
            "of the machines, and whether tactilux is installed there with its extra train, or "
            "render in one process without --workers and --dask",
            field="dask",
        ) from error
    return found
