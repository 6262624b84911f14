"""The lobe of a skin of triangles by analog photons: ``skin_lobe`` at any bend and shape."""

from __future__ import annotations

import numpy as np

from tests.oracles.analog_tracer import ENDS, Floats, Lamp, compiled, emit
from tests.oracles.mesh_tracer import CLEAR, MeshPad, follow
from tests.oracles.skin_lobe import Sights, leave_skin, show


@compiled
def trace_photons_to_mesh_sights(
    pad: MeshPad,
    lamp: Lamp,
    place: int,
    count: int,
    seed: int,
    area: Floats,
    sights: Sights,
    targets: int,
) -> tuple[Floats, Floats, Floats]:
    """Return power per bin ``(bin,)``, light by the lobe ``(target,)``, and where power ends.

    ``count`` photons share the lamp's power of 1, which is in ``place``. The second is the sum over
    lines of sight of weight times radiance.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    tally, seen, ends = np.zeros(len(area)), np.zeros(targets), np.zeros(ENDS + 1)
    p, d = np.zeros(3), np.zeros(3)
    for _ in range(count):
        emit(state, lamp, p, d)
        weight, face, here = follow(state, pad, p, d, 1.0, -1, place, ends)
        while weight > 0.0:
            tally[here] += weight
            show(state, pad, sights, here, area[here], d, pad.normal[face], weight, seen)
            weight = leave_skin(state, pad, d, pad.normal[face], weight, ends)
            if weight > 0.0:
                weight, face, here = follow(state, pad, p, d, weight, face, CLEAR, ends)
    return tally / count, seen / count, ends / count
