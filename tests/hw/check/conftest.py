"""The shipped model's prediction for a design."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.check.prediction import Prediction, predict
from surrogate.runtime.checker import Checker

MODEL = Path(__file__).parents[3] / "models" / "finger20"


@pytest.fixture(scope="session")
def checker() -> Checker:
    """Load the shipped model."""
    return Checker.load(MODEL, threads=2)


@pytest.fixture(scope="session")
def prediction(checker: Checker) -> Prediction:
    """Ask for a design in three colors, every fiber at 70 deg."""
    return predict(checker, np.radians(np.full(20, 70.0)), np.eye(3)[np.arange(20) % 3], 0.0)
