"""The ``measured_light`` emitter: a Mitsuba area light with the beam of a data sheet.

Attach it to a disk (or any shape) whose normal is the beam's axis::

    {'type': 'disk', 'to_world': ..., 'emitter': {'type': 'measured_light', 'filename': 'led.ies'}}

Parameters: ``filename`` of an IES file or of lines of angle and intensity
(``render.scene.measured_profile``); ``power`` (total, default 1), to which the file is scaled. It
works with every Mitsuba integrator.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.errors import RenderError
from render.integrators.profile_emitter import ProfileEmitter
from render.optics.fiber_profile import angle
from render.optics.measured_profile import measured_density, sample_measured
from render.scene.measured_profile import MeasuredProfile

COSINE_MIN = 1e-6
"""Where radiance is cut, which grows as 1 / cosine of what is measured at grazing angles."""


class MeasuredEmitter(ProfileEmitter):
    """An emitting surface with ``L(theta) = I(theta) / (A cos theta)``."""

    def __init__(self, props: Any) -> None:
        """Read the file."""
        ProfileEmitter.__init__(self, props)
        if "filename" not in props:
            raise RenderError(
                "measured_light needs a filename: an .ies file, or lines of angle and intensity",
                field="filename",
            )
        path = mi.file_resolver().resolve(str(props["filename"]))
        profile = MeasuredProfile.read(Path(str(path)))
        self.theta = mi.Float(profile.theta.astype(np.float32))
        self.intensity = mi.Float(profile.intensity.astype(np.float32))
        self.step_sums = np.append(0.0, np.cumsum(profile.step_flux())).astype(np.float32)
        self.step_sums[-1] = 1.0
        self.cumulative = mi.Float(self.step_sums)
        self._per_area: float | None = None

    @property
    def per_area(self) -> float:
        """Power over area; known once the shape, and so its area, is attached."""
        if self._per_area is None:
            self._per_area = self.power / self.area()
        return self._per_area

    def radiance(self, local: Any) -> Any:
        """Return the radiance in directions about the normal +z; 0 behind the surface."""
        theta, last = angle(local), dr.width(self.theta) - 1
        i = dr.binary_search(
            0, last - 1, lambda k: dr.gather(mi.Float, self.theta, mi.UInt32(k) + 1) <= theta
        )
        i = mi.UInt32(i)
        low, high = (dr.gather(mi.Float, self.theta, i + k) for k in (0, 1))
        first, second = (dr.gather(mi.Float, self.intensity, i + k) for k in (0, 1))
        intensity = dr.lerp(first, second, dr.clip((theta - low) / (high - low), 0.0, 1.0))
        value = self.per_area * intensity / dr.maximum(local.z, COSINE_MIN)
        end = dr.gather(mi.Float, self.theta, mi.UInt32(last))
        return mi.Spectrum(dr.select((local.z > 0) & (theta <= end), value, 0.0))

    def sample_local(self, u: Any, v: Any) -> Any:
        """Return unit directions about +z."""
        return sample_measured(u, v, self.cumulative, mi.UInt32(0))

    def local_density(self, local: Any) -> Any:
        """Return the density per solid angle of ``sample_local``."""
        return measured_density(angle(local), self.cumulative, mi.UInt32(0))

    def to_string(self) -> str:
        """Describe the emitter."""
        return f"MeasuredEmitter[power = {self.power:g}]"
