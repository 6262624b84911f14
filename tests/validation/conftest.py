"""Every test leaves Dr.Jit as it found it."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def no_scene_stays() -> Iterator[None]:
    """Free the scenes of a test: Dr.Jit 1.5 mixes up the functions of many that are alive."""
    yield
    gc.collect()
