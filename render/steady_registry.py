"""Virtual function calls of one kernel see one set of Mitsuba objects.

Dr.Jit (1.5) compiles a virtual function call for all living objects of the class, of any scene, and
names each function by a hash of its code. It keeps functions of calls with one object apart from
those of calls with several (``GlobalKey`` in ``eval.h`` of Dr.Jit-Core). One that is needed by both
kinds of call in one kernel is therefore defined twice, and LLVM ends the process: "invalid
redefinition of function".

That takes a number of objects that passes between one and several while a kernel is traced. What
changes it is Python's garbage collector: tracing in Python sets it off, and it frees older scenes
that a cycle holds, such as the traceback of an error. So nothing older is collected meanwhile.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_depth = 0


@contextmanager
def steady_registry() -> Iterator[None]:
    """Keep what the garbage collector could free as it is, while kernels are traced.

    May be nested, and decorate functions. Other threads must not load or drop a scene meanwhile.
    """
    global _depth
    with _lock:
        # Unlike a collector that is off, this also holds where someone calls it by hand. Nested,
        # it holds for what has become garbage since.
        gc.freeze()
        _depth += 1
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            if _depth == 0:
                gc.unfreeze()
