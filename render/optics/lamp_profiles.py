"""The profiles of all lamps of a scene as Dr.Jit arrays: radiance, sampling and its density.

Only the kinds that the scene has are compiled: Gaussian (``render.optics.fiber_profile``), powers
of the cosine, and measured tables (``render.optics.measured_profile``). Power is 1.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.optics.fiber_profile import (
    density,
    falloff,
    peak_radiance,
    sample_direction,
    truncated_mass,
)
from render.optics.measured_profile import measured_density, sample_measured
from render.scene import Profile
from render.scene.measured_profile import STEPS

GAUSSIAN, COSINE, MEASURED = range(3)
TABLE_STEPS = 1440
"""Steps of theta in which measured intensity is tabulated; each is 1/16 of a degree."""
COSINE_MIN = 1e-4
"""Where measured radiance is cut, which grows as 1 / cosine of what is measured at grazing."""


class LampProfiles:
    """What each lamp sends out at an angle theta from its axis, per area of its end."""

    def __init__(self, profiles: list[Profile], areas: list[float]) -> None:
        """Upload one profile and one area (mm^2) for each lamp."""
        kinds, widths, norms, peaks, first = [], [], [], [], []
        sums: list[np.ndarray] = [np.linspace(0.0, 1.0, STEPS + 1)]
        tables: list[np.ndarray] = [np.zeros(TABLE_STEPS + 1)]
        theta = np.linspace(0.0, np.pi / 2, TABLE_STEPS + 1)
        for profile, area in zip(profiles, areas, strict=True):
            measured = profile.measured
            if profile.sigma_v is not None:
                kinds.append(GAUSSIAN)
                widths.append(profile.sigma_v)
                norms.append(truncated_mass(profile.sigma_v))
                peaks.append(peak_radiance(profile.sigma_v, area))
            else:
                kinds.append(COSINE if measured is None else MEASURED)
                widths.append(profile.cosine_exponent or 1.0)
                norms.append(1.0)
                peaks.append(profile.peak_intensity / area)
            first.append(len(tables) if measured is not None else 0)
            if measured is not None:
                sums.append(np.append(0.0, np.cumsum(measured.step_flux())))
                sums[-1][-1] = 1.0
                tables.append(profile.shape(theta))
        self.kinds = frozenset(kinds)
        self.kind = mi.UInt32(kinds)
        # sigma_v or the exponent; the part of a Gaussian below pi/2; radiance on the axis.
        self.width, self.norm, self.peak = mi.Float(widths), mi.Float(norms), mi.Float(peaks)
        self.table_number = mi.UInt32(first)
        self.sums = mi.Float(np.concatenate(sums).astype(np.float32))
        self.table = mi.Float(np.concatenate(tables).astype(np.float32))
        dr.make_opaque(
            self.kind, self.width, self.norm, self.peak, self.table_number, self.sums, self.table
        )

    def _is(self, lamp: mi.UInt32, kind: int) -> mi.Bool:
        if self.kinds == {kind}:
            return mi.Bool(True)
        return dr.gather(mi.UInt32, self.kind, lamp) == kind

    def radiance(self, lamp: mi.UInt32, theta: mi.Float) -> mi.Float:
        """Return radiance in 1/(mm^2 sr); 0 behind the end."""
        width = dr.gather(mi.Float, self.width, lamp)
        peak = dr.gather(mi.Float, self.peak, lamp)
        value = mi.Float(0.0)
        if GAUSSIAN in self.kinds:
            value = dr.select(self._is(lamp, GAUSSIAN), falloff(theta, width), value)
        cosine = dr.cos(theta)
        if COSINE in self.kinds:
            power = dr.select(cosine > 0, dr.power(dr.maximum(cosine, 0.0), width - 1.0), 0.0)
            value = dr.select(self._is(lamp, COSINE), power, value)
        if MEASURED in self.kinds:
            place = dr.clip(theta * (TABLE_STEPS * 2 / dr.pi), 0.0, float(TABLE_STEPS))
            step = dr.minimum(mi.UInt32(place), TABLE_STEPS - 1)
            at = dr.gather(mi.UInt32, self.table_number, lamp) * (TABLE_STEPS + 1) + step
            low, high = (dr.gather(mi.Float, self.table, at + k) for k in (0, 1))
            intensity = dr.lerp(low, high, place - mi.Float(step))
            shown = dr.select(cosine > 0, intensity / dr.maximum(cosine, COSINE_MIN), 0.0)
            value = dr.select(self._is(lamp, MEASURED), shown, value)
        return peak * value

    def sample(self, lamp: mi.UInt32, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """Return unit directions about +z."""
        width = dr.gather(mi.Float, self.width, lamp)
        local = mi.Vector3f(0.0, 0.0, 1.0)
        if GAUSSIAN in self.kinds:
            gaussian = sample_direction(u, v, width, dr.gather(mi.Float, self.norm, lamp))
            local = dr.select(self._is(lamp, GAUSSIAN), gaussian, local)
        if COSINE in self.kinds:
            # cos^(n + 1) is uniform.
            log = dr.log(dr.maximum(1.0 - u, 1e-38)) / (width + 1.0)
            sine = dr.sqrt(dr.maximum(1.0 - dr.exp(2.0 * log), 0.0))
            s, c = dr.sincos(2.0 * dr.pi * v)
            power = mi.Vector3f(sine * c, sine * s, dr.exp(log))
            local = dr.select(self._is(lamp, COSINE), power, local)
        if MEASURED in self.kinds:
            first = dr.gather(mi.UInt32, self.table_number, lamp) * (STEPS + 1)
            local = dr.select(
                self._is(lamp, MEASURED), sample_measured(u, v, self.sums, first), local
            )
        return local

    def density(self, lamp: mi.UInt32, theta: mi.Float) -> mi.Float:
        """Return the density per solid angle of ``sample``."""
        width = dr.gather(mi.Float, self.width, lamp)
        pdf = mi.Float(0.0)
        if GAUSSIAN in self.kinds:
            gaussian = density(theta, width, dr.gather(mi.Float, self.norm, lamp))
            pdf = dr.select(self._is(lamp, GAUSSIAN), gaussian, pdf)
        if COSINE in self.kinds:
            cosine = dr.cos(theta)
            power = dr.power(dr.maximum(cosine, 0.0), width) * (width + 1.0) / (2.0 * dr.pi)
            pdf = dr.select(self._is(lamp, COSINE), dr.select(cosine > 0, power, 0.0), pdf)
        if MEASURED in self.kinds:
            first = dr.gather(mi.UInt32, self.table_number, lamp) * (STEPS + 1)
            pdf = dr.select(
                self._is(lamp, MEASURED), measured_density(theta, self.sums, first), pdf
            )
        return pdf
