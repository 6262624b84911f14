"""Runs of the program on streams, disks and signals as a user may have them."""

from __future__ import annotations

import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from render.files import TEMPORARY

ROOT = Path(__file__).parents[3]
NOISE = re.compile(
    r'Traceback|Exception ignored|^ *File "|^Exception in|Segmentation|Aborted', re.M
)


@dataclass(frozen=True)
class Ended:
    """How a run ended: exit code, negative for a signal, and what it said."""

    code: int
    out: str
    err: str


def _close_all() -> None:
    for number in range(3):
        os.close(number)


def room(size: int) -> Callable[[], None]:
    """Return what leaves a process no room for more than ``size`` bytes in any file."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


PREPARED: dict[str, Callable[[], None]] = {
    "stdout closed": lambda: os.close(1),
    "all closed": _close_all,
    "no room at all": room(0),
    "room for 3 kB": room(3000),
    "room for 30 kB": room(30_000),
}
"""Faults that the process itself has, by name."""
LITTLE_MEMORY = {
    "6 GiB of addresses": lambda: resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
}
"""For commands that compile nothing: what others reserve depends on the machine."""
ENVIRONMENT: dict[str, dict[str, str]] = {
    "no home": {"HOME": "/proc/nothing"},
    "home is a device": {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/full"},
    "cache is a device": {"XDG_CACHE_HOME": "/dev/null"},
    "temporary files have no place": {"TMPDIR": "/dev/null/nowhere"},
}
"""Faults around it."""
STREAMS = ("stdout full", "stderr full", "nobody reads stdout", "nobody reads", "stdout closed",
           "all closed")  # fmt: skip
"""Faults of its standard streams."""
SIGNALS = {signal.SIGINT: (130, -signal.SIGINT), signal.SIGTERM: (143, -signal.SIGTERM)}
"""Exit codes by signal: what is not yet, or no longer, at work ends by the signal itself."""


START = f"""
import sys, _signal
from hw.start import main
_signal.signal(_signal.SIGINT, _signal.SIG_DFL)
_signal.pthread_sigmask(_signal.SIG_UNBLOCK, {tuple(map(int, SIGNALS))})
sys.argv[0] = "tactilux"
main()
"""
"""What the installed script does. Signals wait until Python itself has started, which answers one
with a traceback before any program can help it."""


def _prepare(fault: str) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    (PREPARED | LITTLE_MEMORY).get(fault, lambda: None)()


def run(
    words: tuple[object, ...],
    folder: Path,
    fault: str = "",
    *,
    sent: signal.Signals | None = None,
    after: float = 0.0,
    environment: Mapping[str, str] | None = None,
    seconds: float = 300.0,
) -> Ended:
    """Run ``tactilux`` with ``words`` in ``folder`` under one fault; ``sent`` goes to it later."""
    settings = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    settings |= ENVIRONMENT.get(fault, {}) | dict(environment or {})
    out, err = subprocess.PIPE, subprocess.PIPE
    opened = []
    if fault in ("stdout full", "stderr full"):
        opened.append(os.open("/dev/full", os.O_WRONLY))
        out, err = (opened[0], err) if fault == "stdout full" else (out, opened[0])
    if fault.startswith("nobody reads"):
        reader, writer = os.pipe()
        os.close(reader)
        opened.append(writer)
        out, err = writer, writer if fault == "nobody reads" else err
    process = subprocess.Popen(
        [sys.executable, "-c", START, *map(str, words)],
        cwd=folder,
        env=settings,
        stdin=subprocess.DEVNULL,
        stdout=out,
        stderr=err,
        preexec_fn=partial(_prepare, fault),
        text=True,
    )
    for descriptor in opened:
        os.close(descriptor)
    if sent is not None:
        time.sleep(after)
        process.send_signal(sent)
    try:
        said = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return Ended(process.returncode, said[0] or "", said[1] or "")


def check(ended: Ended, folder: Path, allowed: tuple[int, ...]) -> None:
    """Refuse other exit codes, traces of the program's inside, and unfinished files."""
    what = f"exit code {ended.code}\n{ended.out[-2000:]}\n{ended.err[-2000:]}"
    assert ended.code in allowed, what
    assert not NOISE.search(ended.out + ended.err), what
    if ended.code >= 0:
        left = [str(path) for path in folder.rglob("*") if TEMPORARY.fullmatch(path.name)]
        assert not left, left
