"""Memory that libraries take without asking: without it OpenBLAS loops and C++ aborts."""

from __future__ import annotations

import mmap
import os
from functools import cache

from render.errors import RenderError

MEGABYTE = 1_000_000
START, PREVIEW, RENDERER = 250, 780, 1400
"""MB of addresses that NumPy takes, that OpenGL and SciPy do, and that Mitsuba and torch do."""
PER_CORE = 60
"""MB for the buffers and stacks of threads, of which every library has one per core."""
_NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000)  # Python 3.13 has its name


@cache
def require_memory(megabytes: int, what: str) -> None:
    """Refuse to begin ``what`` where a limit leaves fewer addresses than it takes.

    They are asked for and given back: that costs nothing, and no limit has to be known. Once in a
    process, since what has begun has what it takes.

    Raises:
        RenderError: names the amount and the usual limit.
    """
    needed = (megabytes + PER_CORE * len(os.sched_getaffinity(0))) * MEGABYTE
    kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _NO_RESERVE
    try:
        mmap.mmap(-1, needed, flags=kind).close()
    except (OSError, MemoryError):
        raise RenderError(
            f"there is not enough memory for {what}, which takes {needed / 1e9:.1f} GB of "
            "addresses: close other programs, or raise the limit (ulimit -v unlimited)",
            field="memory",
        ) from None
