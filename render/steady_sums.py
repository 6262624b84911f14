"""Sums in one order on any number of cores: linear algebra on one thread.

Threads of BLAS share out the terms of a product, so the last digit of a sum depends on how many
there are. A search that compares such sums takes another turn where two are that close, and ends
with another design: measured on ``finger20``, `tactilux explore` on one core and on two. One thread
is also the quicker way here, since matrices are small and threads wait for each other.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

SETTINGS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Of libraries that are not loaded yet, as SciPy's own BLAS may be: they stay as they begin."""


@contextmanager
def steady_sums() -> Iterator[None]:
    """Hold BLAS and OpenMP to one thread, whatever the environment says.

    May be nested, and decorate functions. What the process does at the same time in other threads
    is held as well.
    """
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in SETTINGS}
    os.environ.update(dict.fromkeys(SETTINGS, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
