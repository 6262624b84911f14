"""Settings that all tests share."""

from __future__ import annotations

from hypothesis import settings

# Two busy cores make any deadline a lottery, and a red build must be reproducible.
settings.register_profile("tactilux", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("tactilux")
