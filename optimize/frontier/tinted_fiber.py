"""A fiber end of one color, for renders of a whole design by Mitsuba's own integrators.

Load this module after a variant is set: the class derives from that variant's emitter.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.fiber_emitter import FiberEmitter


class TintedFiber(FiberEmitter):
    """The ``fiber`` emitter times a color: ``red``, ``green`` and ``blue`` in [0, 1]."""

    def __init__(self, props: Any) -> None:
        """Read the color; it is opaque, so that another one needs no new kernel."""
        FiberEmitter.__init__(self, props)
        self.tint = mi.Color3f([float(props.get(name, 1.0)) for name in ("red", "green", "blue")])
        dr.make_opaque(self.tint)

    def _radiance(self, local: Any) -> Any:
        return FiberEmitter._radiance(self, local) * self.tint
