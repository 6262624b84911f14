"""Manufacturing tolerances (thesis 6.2): an optional section of the scene file.

Each is a distribution of an error around what the scene says. They say how sensors differ from the
scene, not what light does in it, so they have no part in the scene's hash.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from render.arrays import Array
from render.scene.quantities import Part, allowed_range, check_range, quantity_form

RELATIVE = "relative"


@dataclass(frozen=True)
class Spread:
    """A distribution around 0.

    Arguments:
        distribution: ``normal`` (``deviation`` is one standard deviation) or ``uniform``
            (``deviation`` is the half-width).
        deviation: in rad for angles, mm for lengths, a logarithm of the factor for relative ones.
        source: where the value comes from.
    """

    distribution: Literal["normal", "uniform"]
    deviation: float
    source: str

    @property
    def sigma(self) -> float:
        """One standard deviation."""
        return self.deviation / (1.0 if self.distribution == "normal" else math.sqrt(3.0))

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Return errors of ``shape``."""
        if self.distribution == "normal":
            return np.asarray(self.deviation * rng.standard_normal(shape))
        return np.asarray(rng.uniform(-self.deviation, self.deviation, shape))


@dataclass(frozen=True)
class SpreadOf:
    """Annotation of a tolerance: its unit in the file and the largest deviation allowed.

    The form is ``{ distribution = "normal", deviation = ..., unit = "...", source = "..." }``;
    relative tolerances have the unit ``relative`` and act as the factor ``exp(error)``, which is
    1 + error for small ones and never changes a sign.
    """

    unit: str
    high: float

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the validation schema."""
        return core_schema.no_info_plain_validator_function(
            self._read, serialization=core_schema.to_string_ser_schema()
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the form that the file must have."""
        deviation = {"type": "number", "minimum": 0, "not": {"enum": [0]}, "maximum": self.high}
        fields = {"distribution": {"enum": ["normal", "uniform"]}, "deviation": deviation}
        return quantity_form(fields, self.unit) | {
            "description": f"Allowed: {allowed_range(0.0, self.high, self.unit)}."
        }

    def _read(self, raw: object) -> Spread:
        if isinstance(raw, Spread):
            return raw
        keys = {"distribution", "deviation", "unit", "source"}
        if not isinstance(raw, dict) or set(raw) != keys:
            raise ValueError(
                'must have the form { distribution = "normal", deviation = ..., '
                f'unit = "{self.unit}", source = "..." }}'
            )
        if raw["distribution"] not in ("normal", "uniform"):
            raise ValueError('distribution must be "normal" or "uniform"')
        if raw["unit"] != self.unit:
            raise ValueError(f'unit must be "{self.unit}"')
        if not isinstance(raw["source"], str) or not raw["source"].strip():
            raise ValueError('source must say where the value comes from, or be "assumed"')
        deviation = raw["deviation"]
        if isinstance(deviation, bool) or not isinstance(deviation, int | float):
            raise ValueError("deviation must be a number")
        check_range(float(deviation), 0.0, self.high, self.unit)
        size = math.radians(deviation) if self.unit == "deg" else float(deviation)
        return Spread(raw["distribution"], size, raw["source"])


def _positive(spread: Spread) -> Spread:
    if not spread.deviation > 0.0:
        raise ValueError("deviation must be above 0: leave out what has no tolerance")
    return spread


Relative = Annotated[Spread, SpreadOf(RELATIVE, 0.5), AfterValidator(_positive)]
Degrees = Annotated[Spread, SpreadOf("deg", 30.0), AfterValidator(_positive)]
Millimeters = Annotated[Spread, SpreadOf("mm", 2.0), AfterValidator(_positive)]


class Tolerances(Part):
    """How sensors differ from the scene; what is not named is exact.

    Per fiber: ``led_power`` (factor), ``fiber_angle`` (added to phi), ``sigma_v`` (factor). Per
    sensor: ``scattering`` (factor on sigma_s), ``diffuser_thickness`` (added), ``camera_gain``
    (factor on the exposure).
    """

    led_power: Relative | None = None
    fiber_angle: Degrees | None = None
    sigma_v: Relative | None = None
    scattering: Relative | None = None
    diffuser_thickness: Millimeters | None = None
    camera_gain: Relative | None = None

    def spreads(self) -> dict[str, Spread]:
        """Return the tolerances that are named."""
        named = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: spread for name, spread in named.items() if spread is not None}

    def sentences(self) -> Iterator[str]:
        """Yield the tolerances in words."""
        for name, spread in self.spreads().items():
            size, unit = spread.deviation, ""
            if name == "fiber_angle":
                size, unit = math.degrees(size), " deg"
            elif name == "diffuser_thickness":
                unit = " mm"
            else:
                size, unit = 100 * size, " %"
            words = "standard deviation" if spread.distribution == "normal" else "half-width"
            yield f"{name}: {spread.distribution}, {words} {size:g}{unit} ({spread.source})"
