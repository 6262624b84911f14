"""Light through a wide slab by the walk that all subpaths of level 2 take; import after a variant.

``render.paths.walk`` knows no slabs: rays start in the air, upright, and are followed until they
escape to one side or the other.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.paths.walk import begin_subpath, sample_scattering, trace_segment
from render.sampling.streams import HashedStream


@dr.syntax
def _walk(scene: mi.Scene, z: float, seed: mi.UInt32) -> tuple[mi.Float, mi.Float]:
    """Return, per lane, the weight that escapes towards -z and towards +z."""
    stream = HashedStream(seed)
    width = dr.width(seed)
    # Off the diagonal, along which the triangles of a cube's face meet.
    origin = mi.Point3f(0.1, 0.2, z) + dr.zeros(mi.Point3f, width)
    state = begin_subpath(
        origin, mi.Vector3f(0, 0, 1), dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0),
        mi.Float(0), stream.event(mi.UInt32(0))[0],
    )  # fmt: skip
    back, through = dr.zeros(mi.Float, width), dr.zeros(mi.Float, width)
    event = mi.UInt32(1)
    active = dr.full(mi.Bool, True, width)
    while active:
        state, vertex, arrived, escaped = trace_segment(scene, state, active)
        weight = dr.mean(state.beta)
        back += dr.select(escaped & (state.d.z < 0), weight, 0.0)
        through += dr.select(escaped & (state.d.z > 0), weight, 0.0)
        state, alive = sample_scattering(
            state, vertex, mi.TransportMode.Importance, stream.event(event), arrived
        )
        active &= ~escaped & (~arrived | alive)
        event += 1
    return back, through


def escaping(scene: mi.Scene, z: float, lanes: int, batches: int, seed: int) -> np.ndarray:
    """Return the parts ``(batch, 2)`` of light from height ``z`` that escape to -z and to +z."""
    found = []
    for batch in range(batches):
        number = mi.UInt32(seed * batches + batch)
        dr.make_opaque(number)
        seeds = mi.sample_tea_32(dr.arange(mi.UInt32, lanes), number, 6)[0]
        found.append([np.array(part, dtype=np.float64).mean() for part in _walk(scene, z, seeds)])
    return np.array(found)
