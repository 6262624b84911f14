"""Registration of this package's Mitsuba plugins, once per variant."""

from __future__ import annotations

import mitsuba as mi

_registered: set[str] = set()


def register() -> None:
    """Register all plugins for the variant that is set."""
    if mi.variant() in _registered:
        return
    _registered.add(mi.variant())
