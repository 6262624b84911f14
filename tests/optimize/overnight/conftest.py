"""A night of a tiny sensor that nothing disturbed: made once, looked at by many tests."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.optimize.overnight.tiny import write_tiny
from tests.optimize.overnight.warm import WarmProgram

SAMPLES = 8


@dataclass(frozen=True)
class TinyNight:
    """A finished run, and what it said."""

    scene: Path
    run: Path
    events: list[dict[str, object]]
    said: str
    seconds: float


@pytest.fixture(scope="session")
def warm_program(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmProgram]:
    program = WarmProgram(tmp_path_factory.mktemp("warm"))
    yield program
    program.close()


@pytest.fixture(scope="session")
def tiny_night(tmp_path_factory: pytest.TempPathFactory, warm_program: WarmProgram) -> TinyNight:
    folder = tmp_path_factory.mktemp("night")
    scene, run = write_tiny(folder), folder / "run"
    began = time.monotonic()
    words = ("overnight", scene, "--out", run, "--samples", SAMPLES, "--json-lines")
    process = warm_program.start(*words)
    code, said = process.wait()
    assert code == 0, said
    events = [json.loads(line) for line in process.out.read_text().splitlines()]
    return TinyNight(scene, run, events, said, time.monotonic() - began)
