"""The ``fiber`` emitter: a Mitsuba area light with the Gaussian profile of an optical fiber.

Attach it to a disk (or any shape) whose normal is the beam's axis::

    {'type': 'disk', 'to_world': ..., 'emitter': {'type': 'fiber', 'sigma_v': 15.0, 'power': 1.0}}

Parameters: ``sigma_v`` in degrees; either ``power`` (total, default 1) or ``radiance`` (on axis).
Profile: thesis 3.3.1, see ``render.optics.fiber_profile``. It works with every Mitsuba
integrator.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.errors import RenderError
from render.integrators.profile_emitter import ProfileEmitter, check_amount
from render.optics.fiber_profile import (
    angle,
    falloff,
    peak_radiance,
    sample_direction,
    truncated_mass,
)
from render.optics.fiber_profile import density as profile_density


class FiberEmitter(ProfileEmitter):
    """An emitting surface with ``L(theta) = L_max exp(-(theta / (2 sigma_v))^2)``."""

    def __init__(self, props: Any) -> None:
        """Read the parameters; the peak follows from the shape's area unless it is given."""
        ProfileEmitter.__init__(self, props)
        degrees = float(props.get("sigma_v", 15.0))
        if not 0.1 <= degrees <= 89.0:
            raise RenderError(f"sigma_v = {degrees:g} deg, allowed: 0.1 to 89 deg", field="sigma_v")
        self.sigma_v = degrees * dr.pi / 180
        given: Any = props.get("radiance", None)
        self.given = None if given is None else float(given)
        if self.given is not None:
            check_amount("radiance", self.given)
        self.norm = truncated_mass(self.sigma_v)
        self._peak: float | None = None

    @property
    def peak(self) -> float:
        """On-axis radiance; known once the shape, and so its area, is attached."""
        if self._peak is None:
            given = self.given
            self._peak = (
                self.power * peak_radiance(self.sigma_v, self.area()) if given is None else given
            )
        return self._peak

    def radiance(self, local: Any) -> Any:
        """Return the radiance in directions about the normal +z; 0 behind the end."""
        return mi.Spectrum(self.peak * falloff(angle(local), self.sigma_v))

    def sample_local(self, u: Any, v: Any) -> Any:
        """Return unit directions about +z."""
        return sample_direction(u, v, self.sigma_v, self.norm)

    def local_density(self, local: Any) -> Any:
        """Return the density per solid angle of ``sample_local``."""
        return profile_density(angle(local), self.sigma_v, self.norm)

    def to_string(self) -> str:
        """Describe the emitter."""
        return f"FiberEmitter[sigma_v = {self.sigma_v:g} rad, peak radiance = {self.peak:g}]"
