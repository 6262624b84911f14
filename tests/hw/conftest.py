"""Emulated boards behind real serial ports, and the shipped model's prediction for a design."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from hw.check.prediction import PadPrediction, predict
from hw.leds import ProtocolName
from surrogate.runtime import Checker
from tests.hw.faulty_board import BoardFaults, FaultyBoard

MODEL = Path(__file__).parents[2] / "models" / "finger20"
Plug = Callable[..., FaultyBoard]


@pytest.fixture
def plug(tmp_path: Path) -> Iterator[Plug]:
    """Plug emulated boards in; they are unplugged after the test."""
    with ExitStack() as stack:

        def one(protocol: str = "lines", leds: int = 20, **faults: object) -> FaultyBoard:
            wrong = BoardFaults(**faults)  # type: ignore[arg-type]
            board = FaultyBoard(tmp_path / "port", ProtocolName(protocol), leds, wrong)
            stack.enter_context(board)
            return board

        yield one


@pytest.fixture(scope="session")
def checker() -> Checker:
    """Load the shipped model."""
    return Checker.load(MODEL, threads=2)


@pytest.fixture(scope="session")
def prediction(checker: Checker) -> PadPrediction:
    """Ask for a design in three colors, every fiber at 70 deg."""
    return predict(checker, np.radians(np.full(20, 70.0)), np.eye(3)[np.arange(20) % 3], 0.0)
