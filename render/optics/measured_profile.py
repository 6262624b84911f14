"""Directions of measured lamps (``render.scene.measured_profile``), sampled as Dr.Jit arrays.

They are drawn from the profile's mass in ``STEPS`` equal steps of theta, evenly within each.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.scene.measured_profile import STEPS


def sample_measured(u: mi.Float, v: mi.Float, cumulative: mi.Float, first: mi.UInt32) -> Any:
    """Return unit directions about +z.

    ``cumulative`` holds tables of ``STEPS + 1`` sums of ``step_flux`` from 0 to 1, one after the
    other; that of a lane begins at ``first``.
    """
    step = dr.binary_search(
        0, STEPS - 1, lambda i: dr.gather(mi.Float, cumulative, first + mi.UInt32(i) + 1) <= u
    )
    low = dr.gather(mi.Float, cumulative, first + step)
    high = dr.gather(mi.Float, cumulative, first + step + 1)
    within = dr.clip((u - low) / dr.maximum(high - low, 1e-30), 0.0, 1.0)
    width = 0.5 * dr.pi / STEPS
    # 1 - cos keeps its digits near the axis.
    below, above = (2.0 * dr.square(dr.sin(0.5 * width * (mi.Float(step) + k))) for k in (0, 1))
    versine = below + within * (above - below)
    sine = dr.sqrt(dr.maximum(versine * (2.0 - versine), 0.0))
    s, c = dr.sincos(2.0 * dr.pi * v)
    return mi.Vector3f(sine * c, sine * s, 1.0 - versine)


def measured_density(theta: mi.Float, cumulative: mi.Float, first: mi.UInt32) -> mi.Float:
    """Return the density per solid angle of ``sample_measured``."""
    width = 0.5 * dr.pi / STEPS
    front = (theta >= 0) & (theta < 0.5 * dr.pi)
    step = dr.minimum(mi.UInt32(dr.select(front, theta, 0.0) / width), STEPS - 1)
    low = dr.gather(mi.Float, cumulative, first + step)
    high = dr.gather(mi.Float, cumulative, first + step + 1)
    below, above = (2.0 * dr.square(dr.sin(0.5 * width * (mi.Float(step) + k))) for k in (0, 1))
    return dr.select(front, (high - low) / (2.0 * dr.pi * (above - below)), 0.0)
