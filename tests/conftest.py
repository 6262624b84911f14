"""Settings that all tests share."""

from __future__ import annotations

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
