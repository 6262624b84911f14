"""Settings that all tests share."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

# Two busy cores make any deadline a lottery, and a red build must be reproducible.
settings.register_profile("tactilux", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("tactilux")


@pytest.fixture(scope="session")
def mono() -> ModuleType:
    """Return Mitsuba in the mono variant that the reference renderer uses."""
    from render.llvm import mitsuba

    return mitsuba("llvm_ad_mono")


@dataclass(frozen=True)
class Result:
    """What a command did."""

    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture
def tactilux(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> Run:
    """Run the program in an empty directory and return exit code, stdout and stderr."""
    from hw.cli import main

    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["tactilux", *map(str, arguments)])
        capfd.readouterr()
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        said = capfd.readouterr()
        return Result(code, said.out, said.err)

    return run
