"""How the time of a night falls with the number of workers: simulated from its own renders.

Assumptions, all of them:

- A worker renders every job in the seconds that it took in the run; nobody slows anybody down.
- Jobs are cut as they were in the run and given out in their order, each to the worker that is free
  first (list scheduling; Graham 1969 bounds it by twice the optimum).
- A stage begins when all renders of the one before are kept; within a stage nothing waits.
- Results come home one after the other, in ``TransferCost.handling`` seconds each; workers go on
  meanwhile. Jobs themselves are some kilobytes of text and cost the latency.
- Everything else that the run did (trial renders, which follow each other, fits, searches, the
  report) takes as long as it took.
"""

from __future__ import annotations

import asyncio
import heapq
import os
import sqlite3
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from optimize.design import Array
from optimize.overnight.context import JOB_SECONDS, LOOP_UNTIL, MODEL_UNTIL, TABLE_UNTIL
from optimize.overnight.design_stages import ROUND_SHARE
from optimize.overnight.result import ResultError
from optimize.overnight.store import RECORD
from optimize.ui.console import duration
from render.files import write_json

TRIES = 5
NETWORK = 112e6
"""Bytes per second of gigabit Ethernet after its headers; an assumption, not a measurement."""


@dataclass(frozen=True)
class TransferCost:
    """Seconds of a job besides its rendering, in the process that gives out the jobs.

    Arguments:
        latency: of a message there or back over this machine's loopback, s.
        rate: of an array over the same, bytes per second.
        store: of writing and syncing a result, bytes per second.
        network: of the network between machines, bytes per second.
    """

    latency: float
    rate: float
    store: float
    network: float = NETWORK

    def handling(self, size: Array) -> Array:
        """Return the seconds of receiving and keeping results of ``size`` bytes."""
        slower = min(self.rate, self.network)
        return np.asarray(self.latency + size / slower + size / self.store)


def measure_transfer(folder: Path, size: int) -> TransferCost:
    """Send and keep arrays of ``size`` bytes; ``folder`` is on the disk that results go to."""
    noise = np.random.default_rng(0).random(max(size // 8, 1))
    latency, whole = asyncio.run(_sent(noise))
    return TransferCost(latency, noise.nbytes / max(whole - latency, 1e-9), _kept(folder, noise))


async def _sent(array: Array) -> tuple[float, float]:
    """Return the median seconds of sending next to nothing, and ``array``, with an answer."""
    from distributed.comm import connect, listen
    from distributed.protocol import to_serialize

    async def answer(comm: Any) -> None:
        for _ in range(2 * TRIES + 1):
            await comm.read()
            await comm.write(1)
        await comm.close()

    listener = await listen("tcp://127.0.0.1:0", answer)
    comm = await connect(listener.contact_address)
    try:

        async def seconds(message: Any) -> float:
            began = time.perf_counter()
            await comm.write(message)
            await comm.read()
            return time.perf_counter() - began

        await seconds(0)
        small = [await seconds(0) for _ in range(TRIES)]
        large = [await seconds({"result": to_serialize(array)}) for _ in range(TRIES)]
    finally:
        await comm.close()
        listener.stop()
    return float(np.median(small)), float(np.median(large))


def _kept(folder: Path, array: Array) -> float:
    """Return the bytes per second of writing and syncing ``array``."""
    spent = []
    for _ in range(TRIES):
        began = time.perf_counter()
        with tempfile.TemporaryFile(dir=folder) as stream:
            np.savez(stream, estimate=array)
            stream.flush()
            os.fsync(stream.fileno())
        spent.append(time.perf_counter() - began)
    return float(array.nbytes / np.median(spent))


SCALING = "scaling.json"
WORKERS = (1, 2, 8, 64)
GROWING_STAGES = ("table", "final")
"""Stages that render more when there is more time."""
TRIAL = "trial"
"""The stage whose renders are made one by one, to see how fast they are."""


@dataclass(frozen=True, eq=False)
class StageRenders:
    """Renders that do not wait for each other: seconds and bytes ``(job,)``, in their order."""

    name: str
    seconds: Array
    size: Array


@dataclass(frozen=True)
class ScalingRow:
    """One number of workers.

    Arguments:
        workers: how many.
        seconds: of the same night; speedup: one worker's seconds over these.
        more: how many times as much the table and the final verification would render in the time
            that one worker takes for them.
    """

    workers: int
    seconds: float
    speedup: float
    more: float


@dataclass(frozen=True)
class Scaling:
    """What the simulation says, and what it stands on.

    Arguments:
        rows: by number of workers.
        renders, render_seconds: of the run; serial_seconds: all that was not rendering.
        longest: seconds of the longest render; size: bytes of the largest result.
        transfer: as measured.
        measured_workers: how many rendered the run.
        hours: of the planned night that the rows are about; None for the run itself.
    """

    rows: tuple[ScalingRow, ...]
    renders: int
    render_seconds: float
    serial_seconds: float
    longest: float
    size: int
    transfer: TransferCost
    measured_workers: int
    hours: float | None = None


def write_scaling(run: Path) -> Scaling:
    """Simulate from the record of ``run``, keep the result there and return it."""
    scaling = scaling_of(run, run)
    keep_scaling(run, scaling)
    return scaling


def keep_scaling(run: Path, scaling: Scaling) -> None:
    """Write ``scaling`` into ``run``."""
    write_json(run / SCALING, asdict(scaling), indent=1)


def load_scaling(run: Path) -> Scaling | None:
    """Return what ``write_scaling`` kept in ``run``, None where it did not.

    Raises:
        ResultError: the file is damaged.
    """
    path = run / SCALING
    try:
        return TypeAdapter(Scaling).validate_json(path.read_bytes(), extra="forbid")
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise ResultError(
            f"{path} is damaged ({str(error).splitlines()[0]}): delete it, the next night that "
            "ends here measures anew",
            field="scaling",
        ) from None


def scaling_of(run: Path, scratch: Path, hours: float | None = None) -> Scaling:
    """Return the simulation for the renders that ``run`` has logged so far.

    Arguments:
        run: directory of the run, in which another process may work.
        scratch: folder on whose disk it is tried how fast results are kept.
        hours: of a night as one worker would plan it, instead of what the run did.

    Raises:
        ResultError: nothing was rendered, or the record cannot be read.
    """
    stages, worked, rendered_by = _read(run)
    sizes = np.concatenate([stage.size for stage in stages])
    transfer = measure_transfer(scratch, int(sizes.max()))
    if hours is None:
        return simulated(stages, worked, rendered_by, transfer)
    planned = planned_stages(stages, hours)
    return replace(simulated(planned, 3600 * hours, 1, transfer), hours=hours)


def planned_stages(measured: Sequence[StageRenders], hours: float) -> list[StageRenders]:
    """Return the renders of a night of ``hours`` on one worker, by the shares of its stages.

    They scatter around their planned length as the measured ones do around their mean, and their
    results are as large.
    """
    spread = np.concatenate([stage.seconds / stage.seconds.mean() for stage in measured])
    sizes = np.concatenate([stage.size for stage in measured])

    def stage(name: str, fraction: float, jobs: int) -> StageRenders:
        relative = np.resize(spread, jobs)
        seconds = 3600 * hours * fraction * relative / relative.sum()
        return StageRenders(name, seconds, np.resize(sizes, jobs))

    def jobs_in(fraction: float) -> int:
        return max(1, round(3600 * hours * fraction / JOB_SECONDS))

    loop, final = LOOP_UNTIL - MODEL_UNTIL, 1.0 - LOOP_UNTIL
    rounds = round(1 / ROUND_SHARE)
    return [
        stage("table", TABLE_UNTIL, jobs_in(TABLE_UNTIL)),
        *(stage(f"round {i + 1}", loop / rounds, jobs_in(loop / rounds)) for i in range(rounds)),
        stage("final", final, jobs_in(final)),
    ]


def simulated(
    stages: Sequence[StageRenders], worked: float, rendered_by: int, transfer: TransferCost
) -> Scaling:
    """Return the times for all ``WORKERS``.

    Arguments:
        stages: what was rendered, in order.
        worked: seconds of the whole run.
        rendered_by: workers of the run.
        transfer: of results.
    """
    seconds = np.concatenate([stage.seconds for stage in stages])
    # A render in the process itself travels nowhere.
    way = transfer if rendered_by > 1 else None
    serial = max(worked - sum(makespan(stage, rendered_by, way) for stage in stages), 0.0)
    alone = serial + sum(makespan(stage, 1, None) for stage in stages)
    rows = []
    for workers in WORKERS:
        way = transfer if workers > 1 else None
        spans = [makespan(stage, workers, way) for stage in stages]
        total = serial + sum(spans)
        rows.append(ScalingRow(workers, total, alone / total, _more(stages, workers, way)))
    return Scaling(
        tuple(rows),
        len(seconds),
        float(seconds.sum()),
        serial,
        float(seconds.max()),
        int(max(stage.size.max() for stage in stages)),
        transfer,
        rendered_by,
    )


def scaling_rows(scaling: Scaling) -> list[tuple[str, str, str, str]]:
    """Return workers, time, speed-up and times the renders of every row, as text."""
    return [
        (str(row.workers), duration(row.seconds), f"{row.speedup:.2g}", f"{row.more:.2g}")
        for row in scaling.rows
    ]


def scaling_words(scaling: Scaling) -> str:
    """Say what the rows stand on."""
    way, worker = scaling.transfer, "a machine like this one, which rendered all of them"
    if scaling.measured_workers > 1:
        worker = f"one like the {scaling.measured_workers} that rendered them"
    night = "this night's"
    if scaling.hours is not None:
        night = f"the plan of a night of {scaling.hours:g} h, scattered as this one's, with its"
    return (
        f"Simulated from {night} {scaling.renders} renders ({duration(scaling.render_seconds)} "
        f"in all, the longest {scaling.longest:.0f} s) and from its "
        f"{duration(scaling.serial_seconds)} of other work, which does not shrink. A worker is "
        f"{worker}. Jobs are cut and ordered as they were, given out by list scheduling, and every "
        "stage waits for the one before. A "
        f"result of {scaling.size / 1e6:.2g} MB travels at {way.rate / 1e6:.0f} MB/s (measured "
        f"over this machine's loopback) or at the network's {way.network / 1e6:.0f} MB/s (assumed "
        f"to be gigabit), whichever is less, and is kept at {way.store / 1e6:.0f} MB/s, one after "
        "the other. The last column is for the table and the final verification, cut finely "
        "enough: with --hours, more workers render more in the same time."
    )


def makespan(stage: StageRenders, workers: int, transfer: TransferCost | None) -> float:
    """Return the seconds from the first job given out to the last result kept.

    ``transfer`` None: the jobs stay in this process.
    """
    free = [0.0] * workers
    latency = transfer.latency if transfer else 0.0
    ends = []
    for seconds in stage.seconds:
        ends.append(heapq.heappop(free) + latency + float(seconds))
        heapq.heappush(free, ends[-1])
    handling = transfer.handling(stage.size) if transfer else np.zeros(len(ends))
    kept = 0.0
    for job in np.argsort(ends, kind="stable"):
        kept = max(kept, ends[job]) + float(handling[job])
    return kept


def _more(stages: Sequence[StageRenders], workers: int, transfer: TransferCost | None) -> float:
    """Return how many times the growing stages fit into the time that one worker takes for them."""
    growing = [stage for stage in stages if stage.name in GROWING_STAGES]
    alone = sum(float(stage.seconds.sum()) for stage in growing)
    handled = sum(float(transfer.handling(stage.size).sum()) for stage in growing if transfer)
    return min(float(workers), alone / max(handled, 1e-9))


def _read(run: Path) -> tuple[list[StageRenders], float, int]:
    """Return the stages of ``run``, the seconds worked, and how many workers rendered.

    Raises:
        ResultError: nothing was rendered, or the record cannot be read.
    """
    path = run / RECORD
    try:
        db = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        try:
            rows = db.execute(
                "SELECT kind, key, seconds, worker FROM evaluations WHERE id IN "
                "(SELECT MAX(id) FROM evaluations GROUP BY key) ORDER BY id"
            ).fetchall()
            (worked,) = db.execute("SELECT TOTAL(seconds) FROM attempts").fetchone()
        finally:
            db.close()
    except sqlite3.Error as error:
        raise ResultError(f"{path} cannot be read ({error})", field="run", value=str(run)) from None
    kinds: dict[str, list[tuple[Any, ...]]] = {}
    for row in rows:
        kinds.setdefault(row[0], []).append(row)
    stages = [
        StageRenders(
            kind.partition("/")[2],
            np.array([row[2] for row in entries], dtype=np.float64),
            np.array([_size(run / "renders" / f"{row[1]}.npz") for row in entries], np.float64),
        )
        for kind, entries in kinds.items()
        if not kind.endswith(f"/{TRIAL}")
    ]
    if not stages:
        raise ResultError(
            f"{path} has no renders to learn from yet: ask again when the transport table is "
            "being rendered",
            field="run",
            value=str(run),
        )
    return stages, float(worked), len({row[3] for row in rows if row[3]}) or 1


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise ResultError(
            f"{path} cannot be read ({error.strerror}): go on with tactilux overnight, which "
            "renders it anew",
            field="run",
        ) from None
