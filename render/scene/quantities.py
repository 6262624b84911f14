"""What scene files are made of: parts, quantities with unit, range and source, plain counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


class Part(BaseModel):
    """Base of all scene parts: immutable, no unknown keys, no silent conversion."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def since_schema_2() -> Any:
    """Return the field of an optional key that only files of schema 2 may name.

    A key that is absent is None, and leaves no trace in the hash of a scene.
    """
    return Field(default=None, json_schema_extra={"since_schema": 2})


def keys_of_schema_2(part: Part, prefix: str = "") -> Iterator[str]:
    """Yield the keys that ``part`` names and a file of schema 1 may not."""
    for name, info in type(part).model_fields.items():
        value, key = getattr(part, name), f"{prefix}{name}"
        extra = info.json_schema_extra
        if value is not None and isinstance(extra, dict) and extra.get("since_schema") == 2:
            yield key
        elif isinstance(value, Part):
            yield from keys_of_schema_2(value, f"{key}.")


@dataclass(frozen=True)
class Quantity:
    """Annotation of a scene field: ``{ value = ..., unit = "mm", source = "..." }``.

    Arguments:
        unit: unit required in the file: ``mm``, ``deg``, ``1/mm``, or ``""`` for a pure number.
        low, high: closed allowed range, in file units.
        many: a non-empty list of values instead of one.

    In memory: float64, angles converted from degrees to radians, everything else unchanged.
    """

    unit: str
    low: float
    high: float
    many: bool = False

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the validation schema (unit and source first, then the range)."""
        number: CoreSchema = core_schema.no_info_after_validator_function(
            self._within, core_schema.float_schema(strict=True)
        )
        if self.unit == "deg":
            number = core_schema.no_info_after_validator_function(math.radians, number)
        if self.many:
            number = core_schema.tuple_variable_schema(number, min_length=1, strict=False)
        return core_schema.no_info_before_validator_function(self._unwrap, number)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the form that the file must have."""
        value: dict[str, Any] = {"type": "number", "minimum": self.low, "maximum": self.high}
        if self.many:
            value = {"type": "array", "items": value, "minItems": 1}
        return quantity_form({"value": value}, self.unit) | {
            "description": f"Allowed: {allowed_range(self.low, self.high, self.unit)}."
        }

    @property
    def shape(self) -> str:
        """The form that the file must have, for error messages."""
        value = "[...]" if self.many else "..."
        unit = f', unit = "{self.unit}"' if self.unit else ""
        return f'{{ value = {value}{unit}, source = "..." }}'

    def _within(self, value: float) -> float:
        check_range(value, self.low, self.high, self.unit)
        # Adding 0 turns -0.0 into 0.0, so that both have the same hash.
        return value + 0.0

    def _unwrap(self, raw: object) -> object:
        keys = {"value", "source"} | ({"unit"} if self.unit else set())
        if not isinstance(raw, dict) or set(raw) != keys:
            raise ValueError(f"must have the form {self.shape}")
        if self.unit and raw["unit"] != self.unit:
            raise ValueError(f'unit must be "{self.unit}"')
        if not isinstance(raw["source"], str) or not raw["source"].strip():
            raise ValueError('source must say where the value comes from, or be "assumed"')
        return raw["value"]


class PerChannel(Quantity):
    """Annotation of a pure number that may differ by camera channel: one number, or a list.

    In memory a float, or a tuple ``(channel,)`` of them; only files of schema 2 hold lists.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the validation schema of lists, which single numbers pass by."""
        number = core_schema.no_info_after_validator_function(
            self._within, core_schema.float_schema(strict=True)
        )
        return core_schema.no_info_wrap_validator_function(
            self._one_or_many,
            core_schema.tuple_variable_schema(number, strict=False),
            serialization=core_schema.simple_ser_schema("any"),
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of both forms that the file may have."""
        one: dict[str, Any] = {"type": "number", "minimum": self.low, "maximum": self.high}
        value = {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}
        return quantity_form({"value": value}, self.unit) | {
            "description": f"Allowed: {allowed_range(self.low, self.high, self.unit)}, one number "
            "or one per camera channel."
        }

    def _one_or_many(self, raw: object, many: Callable[[object], Any]) -> Any:
        value = self._unwrap(raw)
        if isinstance(value, list):
            return many(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PydanticCustomError("number_or_list", "allowed: a number, or a list of them")
        return self._within(float(value))


@dataclass(frozen=True)
class Count:
    """Annotation of a plain whole number in ``[low, high]``; it needs no unit and no source."""

    low: int
    high: int

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the validation schema."""
        return core_schema.no_info_after_validator_function(
            self._within, core_schema.int_schema(strict=True)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the number."""
        return {
            "type": "integer",
            "minimum": self.low,
            "maximum": self.high,
            "description": f"Allowed: {allowed_range(self.low, self.high, '')}.",
        }

    def _within(self, value: int) -> int:
        check_range(value, self.low, self.high, "")
        return value


def check_range(value: float, low: float, high: float, unit: str) -> None:
    """Refuse a value outside ``[low, high]``, also NaN, with the whole allowed range."""
    if not low <= value <= high:
        allowed = allowed_range(low, high, unit)
        about = {"allowed": allowed, "low": low}
        raise PydanticCustomError("out_of_range", "allowed: {allowed}", about)


def quantity_form(fields: dict[str, Any], unit: str) -> dict[str, Any]:
    """Return the JSON schema of ``fields`` with the ``unit``, where there is one, and a source."""
    source = {
        "type": "string",
        "pattern": r"\S",
        "description": 'Where the value comes from, or "assumed".',
    }
    return closed_table(fields | ({"unit": {"enum": [unit]}} if unit else {}) | {"source": source})


def closed_table(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON schema of a table of exactly these ``fields``."""
    return {
        "type": "object",
        "properties": fields,
        "required": list(fields),
        "additionalProperties": False,
    }


def allowed_range(low: float, high: float, unit: str) -> str:
    """Return a range in words.

    >>> allowed_range(0.0, 180.0, "deg")
    '0 to 180 deg'
    """
    return f"{low:g} to {high:g} {unit}".rstrip()
