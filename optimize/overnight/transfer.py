"""What it costs to bring a render home: measured as Dask sends it, and as the run keeps it."""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design.design import Array

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
