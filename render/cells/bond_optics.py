"""What a smooth bond of pad and window does to light on its way between skin, window and lamps.

Along the faces wave vectors stay, so the order of layers does not matter to where a way ends, and
unfolded over walls and lower face it is one line that is bent at the bond. ``ratio`` is the index
of the window over that of the pad. Cosines are those to the bond's normal, z.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.cells.lamp_aim import face_crossing

STEPS = 8
"""Of Newton's method."""
THINNEST = 1e-4
"""mm that either medium has at least on a way."""


def through_bond(d: mi.Vector3f, ratio: mi.Float) -> tuple[mi.Vector3f, mi.Float]:
    """Return the direction of light along ``d`` behind the bond, and what passes it."""
    down = d.z < 0
    scale = dr.select(down, dr.rcp(ratio), ratio)
    along = dr.square(scale) * (1.0 - dr.square(d.z))
    rise = dr.mulsign(dr.sqrt(dr.maximum(1.0 - along, 0.0)), d.z)
    cosine = dr.select(down, dr.abs(d.z), -dr.abs(d.z))
    return mi.Vector3f(scale * d.x, scale * d.y, rise), 1.0 - mi.fresnel(cosine, ratio)[0]


@dataclass
class LayeredWay:
    """A way down through pad and window and up again (a Dr.Jit PyTree).

    ``direction``, ``pad_cos`` and ``pad_length`` (mm) are in the pad, ``plate_cos`` and
    ``plate_length`` in the window. ``spread`` is the area across the way per solid angle where it
    begins (mm^2 / sr).
    """

    direction: mi.Vector3f
    pad_cos: mi.Float
    plate_cos: mi.Float
    pad_length: mi.Float
    plate_length: mi.Float
    spread: mi.Float


def layered_way(
    across: mi.Vector3f, pad: mi.Float, plate: mi.Float, ratio: mi.Float, *, plate_is_denser: bool
) -> LayeredWay:
    """Return the way that goes as far as x and y of ``across`` (mm).

    ``pad`` and ``plate`` are the heights (mm) that it crosses of each.
    """
    reach = dr.maximum(dr.hypot(across.x, across.y), 1e-6)
    pad = dr.maximum(pad, THINNEST)
    # From the denser side total reflection says where the crossing is at most.
    if plate_is_denser:
        first, second, denser = plate, pad, ratio
    else:
        first, second, denser = pad, plate, dr.rcp(ratio)
    critical = first * dr.rsqrt(dr.maximum(dr.square(denser) - 1.0, 1e-6))
    lateral = face_crossing(reach, first, second, denser, critical, STEPS)
    by_pad = reach - lateral if plate_is_denser else lateral
    by_plate = reach - by_pad
    pad_length, plate_length = dr.hypot(by_pad, pad), dr.hypot(by_plate, plate)
    cos_1, cos_2 = pad / pad_length, plate / plate_length
    scale = by_pad / (reach * pad_length)
    # Lateral ways per angle in the pad, in the plane of incidence and across it.
    aside = pad_length + plate_length / ratio
    within = pad / dr.square(cos_1) + plate * cos_1 / (ratio * cos_2 * dr.square(cos_2))
    return LayeredWay(
        mi.Vector3f(across.x * scale, across.y * scale, -cos_1), cos_1, cos_2, pad_length,
        plate_length, aside * cos_1 * within,
    )  # fmt: skip
