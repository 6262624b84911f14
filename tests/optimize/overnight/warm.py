"""The program in processes that begin within milliseconds: a process that has imported it forks.

It has used nothing of what it imported, so no thread of Dr.Jit is lost by a fork. Who imports this
module talks to that process through `WarmProgram`.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.optimize.overnight.tiny import ROOT

FIT_STEPS = 40
"""Steps of a fit: what a run survives is not how good its surrogate is."""


class WarmRun:
    """A run of the program, begun by `WarmProgram`."""

    def __init__(self, program: WarmProgram, pid: int, out: Path, err: Path) -> None:
        self.program, self.pid, self.out, self.err = program, pid, out, err

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        os.kill(self.pid, number)

    def poll(self) -> int | None:
        """Return the exit code, None while the run works."""
        code: int | None = self.program.ask({"poll": self.pid})
        return code

    def wait(self) -> tuple[int, str]:
        """Return the exit code and what was said on stderr."""
        while (code := self.poll()) is None:
            time.sleep(0.02)
        return code, self.err.read_text()


class WarmProgram:
    """A process that has imported the program and runs it in forks."""

    def __init__(self, folder: Path) -> None:
        """Start the process; ``folder`` keeps what the runs say."""
        self.folder, self.count = folder, 0
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.optimize.overnight.warm"],
            cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def ask(self, question: dict[str, Any]) -> Any:
        """Return the answer of the process."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(question) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def start(self, *words: object, ahead: float = 0.0, report: bool = True) -> WarmRun:
        """Begin a run of the program, whose clock on the wall is ``ahead`` by so many seconds.

        Without ``report`` none is drawn, because nobody reads it.
        """
        self.count += 1
        out, err = self.folder / f"{self.count}.out", self.folder / f"{self.count}.err"
        pid = self.ask(
            {"words": [*map(str, words)], "ahead": ahead, "report": report,
             "out": str(out), "err": str(err)}
        )  # fmt: skip
        return WarmRun(self, pid, out, err)

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


def wait_for(run: Path, stage: str, process: WarmRun, known: int = 0) -> None:
    """Wait until the log names ``stage`` behind its first ``known`` characters."""
    log = run / "log.txt"
    while process.poll() is None:
        if log.is_file() and f"{stage} ..." in log.read_text()[known:]:
            return
        time.sleep(0.02)
    raise AssertionError(f"it ended before {stage}: {process.err.read_text()}")


def _run(question: dict[str, Any]) -> None:
    """Be the program."""
    import optimize.overnight.context
    import optimize.overnight.report
    from hw.cli import main

    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(question[name], os.O_WRONLY | os.O_CREAT, 0o644), number)
    real, ahead = time.time, question["ahead"]
    time.time = lambda: real() + ahead
    optimize.overnight.context.FIT_STEPS = (FIT_STEPS, FIT_STEPS)
    if not question["report"]:
        optimize.overnight.report.write_report = lambda result, run: run
    sys.argv = ["tactilux", *question["words"]]
    code = 0
    try:
        main()
    except SystemExit as end:
        code = int(end.code or 0)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def main() -> None:
    """Answer questions: begin a run, or say how one ended."""
    import cma  # noqa: F401
    import numba  # noqa: F401

    import surrogate.train  # noqa: F401
    from render.reference.llvm import mitsuba

    mitsuba()
    codes: dict[int, int] = {}
    for line in sys.stdin:
        question = json.loads(line)
        if "words" in question:
            child = os.fork()
            if not child:
                _run(question)
            print(child, flush=True)
            continue
        pid = question["poll"]
        if pid not in codes:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                codes[pid] = os.waitstatus_to_exitcode(status)
        print(json.dumps(codes.get(pid)), flush=True)


if __name__ == "__main__":
    main()
