"""The film sampler and its Mitsuba plugins: ``bdpt``, ``pssmlt`` and the ``fiber`` emitter."""

from __future__ import annotations

import sys

_registered: set[str] = set()


def register() -> None:
    """Register ``fiber``, ``bdpt`` and ``pssmlt`` for the variant that is set, once per variant.

    The classes derive from types of the variant that is set, so their modules are loaded anew.
    """
    import mitsuba as mi

    variant = str(mi.variant())
    if variant in _registered:
        return
    for name in ("render.integrators.fiber_emitter", "render.integrators.bidirectional"):
        sys.modules.pop(name, None)
    from render.integrators.bidirectional import BDPT, PSSMLT
    from render.integrators.fiber_emitter import FiberEmitter

    mi.register_emitter("fiber", FiberEmitter)
    mi.register_integrator("pssmlt", PSSMLT)
    mi.register_integrator("bdpt", BDPT)
    _registered.add(variant)
