"""How a lamp's light falls off beside its axis: Gaussian, a power of the cosine, or measured.

The end of a lamp is a flat disk whose points all shine alike, with radiance ``L(theta)`` at the
angle theta from its axis and intensity ``I(theta) = A L(theta) cos(theta)``, up to a right angle.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import GetJsonSchemaHandler, ValidationError, ValidationInfo, model_validator
from pydantic_core import CoreSchema, PydanticCustomError

from render.arrays import Array
from render.errors import RenderError
from render.scene.measured_profile import MeasuredProfile
from render.scene.quantities import Part, Quantity, closed_table, quantity_form

FORM = (
    '"lambertian", { half_angle = {...} }, { sigma_v = {...} }, { cosine_exponent = {...} } or '
    '{ file = "...", source = "..." }'
)


ANGLES = ("half_angle", "sigma_v")
"""Keys by which a file says how wide a beam is: one of them."""


class HalfAngle(Part):
    """A key that a file may have in place of ``sigma_v``, with the same beam.

    ``half_angle``: angle from the axis at which the intensity of a Gaussian beam falls to a half,
    as data sheets say it. At that angle ``exp(-(theta / (2 sigma_v))^2) cos(theta)`` is 1/2; that
    of every Gaussian is below the 60 deg of a Lambertian end.
    """

    half_angle: Annotated[float, Quantity("deg", 0.2, 56.0)]


def width_of(half_angle: float) -> float:
    """Return sigma_v of the Gaussian whose intensity falls to a half at ``half_angle``, both rad.

    >>> round(math.degrees(width_of(math.radians(30.0))), 2)
    20.24
    """
    return half_angle / (2.0 * math.sqrt(math.log(2.0 * math.cos(half_angle))))


def with_sigma_v(raw: Any) -> Any:
    """Return a part of a file with sigma_v in place of its half angle, if it has one.

    Raises:
        ValidationError: the half angle is refused, or stands beside sigma_v.
    """
    if not isinstance(raw, dict) or "half_angle" not in raw:
        return raw
    given = raw["half_angle"]
    if "sigma_v" in raw:
        twice = PydanticCustomError("two_widths", "allowed: half_angle or sigma_v, not both")
        raise ValidationError.from_exception_data(
            "half_angle", [{"type": twice, "loc": ("half_angle",), "input": given}]
        )
    angle = HalfAngle.model_validate({"half_angle": given}).half_angle
    rest = {key: value for key, value in raw.items() if key != "half_angle"}
    return rest | {"sigma_v": given | {"value": math.degrees(width_of(angle))}}


def schema_with_half_angle(content: dict[str, Any]) -> None:
    """Let the JSON schema of a part that has sigma_v know a half angle in its place."""
    content["properties"] |= HalfAngle.model_json_schema()["properties"]
    content["required"].remove("sigma_v")
    content["oneOf"] = [{"required": ["sigma_v"]}, {"required": ["half_angle"]}]


class Profile(Part):
    """One of three: ``sigma_v``, ``cosine_exponent``, or ``angles`` with ``intensity``.

    ``sigma_v`` (deg in files, rad here): radiance ``exp(-(theta / (2 sigma_v))^2)`` (thesis 3.3.1).
    Files may have a `HalfAngle` in its place.
    ``cosine_exponent`` n: intensity ``cos(theta)^n``, as in data sheets of LEDs; 1 is Lambertian. A
    measured profile has ``angles`` (rad) and ``intensity`` (1/sr at unit power), read from an IES
    or a CSV file.
    """

    sigma_v: Annotated[float, Quantity("deg", 0.1, 89.0)] | None = None
    cosine_exponent: Annotated[float, Quantity("", 1.0, 1000.0)] | None = None
    angles: tuple[float, ...] | None = None
    intensity: tuple[float, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _one_form(cls, raw: Any, info: ValidationInfo) -> Any:
        if raw == "lambertian":
            return {"cosine_exponent": {"value": 1.0, "source": "lambertian"}}
        raw = with_sigma_v(raw)
        keys = set(raw) if isinstance(raw, dict) else set()
        if keys in ({"sigma_v"}, {"cosine_exponent"}):
            return raw
        if keys != {"file", "source"} or not all(isinstance(raw[key], str) for key in keys):
            raise ValueError(f"must be {FORM}")
        folder = (info.context or {}).get("folder", Path())
        try:
            measured = MeasuredProfile.read(folder / raw["file"])
        except RenderError as error:
            raise ValueError(str(error)) from error
        return {
            "angles": tuple(measured.theta.tolist()),
            "intensity": tuple(measured.intensity.tolist()),
        }

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the forms that a file may have."""
        known = handler.resolve_ref_schema(handler(schema))["properties"]
        path = {"type": "string", "description": "IES or CSV, relative to the scene file."}
        forms = [{name: known[name]} for name in ("sigma_v", "cosine_exponent")]
        forms.append(HalfAngle.model_json_schema()["properties"])
        return {
            "description": "How the light of a lamp falls off beside its axis.",
            "anyOf": [
                {"enum": ["lambertian"]},
                quantity_form({"file": path}, ""),
                *(closed_table(form) for form in forms),
            ],
        }

    @property
    def measured(self) -> MeasuredProfile | None:
        """The measured profile, where it is one."""
        if self.angles is None or self.intensity is None:
            return None
        return MeasuredProfile(np.array(self.angles), np.array(self.intensity))

    def radiance(self, theta: Array) -> Array:
        """Return radiance over that on the axis (over the peak intensity of a measured profile)."""
        front = theta < np.pi / 2
        if self.sigma_v is not None:
            return np.asarray(np.exp(-((theta / (2 * self.sigma_v)) ** 2)) * front)
        cosine = np.where(front, np.cos(theta), 1.0)
        if self.cosine_exponent is not None:
            return np.asarray(cosine ** (self.cosine_exponent - 1) * front)
        measured = self.measured
        assert measured is not None
        values = np.interp(theta, measured.theta, measured.intensity, right=0.0)
        return np.asarray(values / measured.intensity.max() / cosine * front)

    def shape(self, theta: Array) -> Array:
        """Return intensity over that on the axis (over the peak of a measured profile)."""
        return np.asarray(self.radiance(theta) * np.where(theta < np.pi / 2, np.cos(theta), 0.0))

    @property
    def peak_intensity(self) -> float:
        """Intensity (1/sr) that `shape` is relative to, of a lamp of unit power."""
        if self.cosine_exponent is not None:
            return (self.cosine_exponent + 1) / (2 * np.pi)
        if self.intensity is not None:
            return max(self.intensity)
        assert self.sigma_v is not None
        from scipy.integrate import quad  # a robot that checks needs none

        flux, _ = quad(
            lambda t: float(self.shape(np.asarray(t))) * np.sin(t),
            0.0,
            np.pi / 2,
            points=[min(2 * self.sigma_v, 1.5)],
            limit=200,
        )
        return float(1.0 / (2 * np.pi * flux))

    @property
    def sentence(self) -> str:
        """The profile in words."""
        from scipy.optimize import brentq

        if self.sigma_v is not None:
            half = brentq(lambda t: float(self.shape(np.asarray(t))) - 0.5, 0.0, np.pi / 3)
            return (
                f"Gaussian, sigma_v {np.degrees(self.sigma_v):.4g} deg, half intensity at "
                f"{np.degrees(half):.3g} deg"
            )
        if self.cosine_exponent == 1.0:
            return "Lambertian"
        if self.cosine_exponent is not None:
            return f"cosine to the power of {self.cosine_exponent:g}"
        return f"measured at {len(self.angles or ())} angles"
