"""What scene files are made of: parts, quantities with unit, range and source, plain counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from render.errors import SceneError
from render.refused_values import allowed_words, in_toml

LONG = 6
"""Values of a list that a part's one line shows; of longer ones it shows how many there are."""
MOST_LISTED = 512
"""Entries of a list or a table of a scene file: whatever is checked in pairs has an end."""


class Part(BaseModel):
    """Base of all scene parts: immutable, no unknown keys, no silent conversion."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy whose values in ``update`` are checked as those of a file.

        They are in memory units (mm, rad); `Scene.with_` takes those of the file.

        Raises:
            SceneError: an unknown key, or a value that no file may have.
        """
        for name, value in (update or {}).items():
            _check_in_memory(type(self), name, value)
        return super().model_copy(deep=deep) if not update else unchecked(self, update)

    def __setattr__(self, name: str, value: Any) -> None:
        """Say how a scene is varied; only what is not of the file can be set."""
        if not name.startswith("_"):
            raise SceneError(
                f"{name} cannot be set to {in_toml(value)}, scenes and their parts never change: "
                "scene.with_(pad_thickness=4.0) returns another, in the units of the file",
                field=name,
            )
        super().__setattr__(name, value)

    def __dir__(self) -> Iterable[str]:
        """Return the names that are ours, without those of the library that reads files."""
        foreign = {name for name in dir(BaseModel) if not name.startswith("_")}
        return sorted(set(super().__dir__()) - foreign)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Yield what the part's one line shows: of long lists their length, nothing that is not."""
        for name, value in super().__repr_args__():
            if isinstance(value, tuple) and len(value) > LONG:
                yield name, f"{len(value)} values"
            elif value is not None:
                yield name, value


Piece = TypeVar("Piece", bound=Part)


def unchecked(part: Piece, update: Mapping[str, Any]) -> Piece:
    """Return ``part`` with other values, in memory units, whatever a file may have.

    For what is computed from a valid scene, as a pad that its window is part of.
    """
    copy = BaseModel.model_copy(part, update=update)
    for name in part.__private_attributes__:  # how it was written is not how the copy is
        setattr(copy, name, None)
    return copy


@lru_cache(maxsize=256)
def _field_reader(kind: type[Part], name: str) -> TypeAdapter[Any]:
    """Return what reads one field of a part, as strictly as the whole part is read."""
    info = kind.model_fields[name]
    alone = isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel)
    named: Any = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
    return TypeAdapter(named, config=None if alone else ConfigDict(strict=True))


def _check_in_memory(kind: type[Part], name: str, value: Any) -> None:
    """Refuse a value in memory units that no file may have."""
    if name not in kind.model_fields:
        allowed = ", ".join(kind.model_fields)
        raise SceneError(f"unknown key {name} of {kind.__name__}, allowed: {allowed}", field=name)
    written = next((one.written(value) for one in quantities_of(kind, name)), value)
    named = value if isinstance(value, tuple) else (value,)
    try:
        # Which LEDs there are is up to the scene.
        _field_reader(kind, name).validate_python(
            value if value is None else written, context={"colors": named}
        )
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        allowed = allowed_words(problem)
        said = f"allowed: {allowed}" if allowed else problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "string_pattern_mismatch":
            said = f"allowed: a text of the form {problem['ctx']['pattern']}"
        given = written["value"] if isinstance(written, dict) and "value" in written else value
        raise SceneError(
            f"{name} of {kind.__name__} = {in_toml(given)}, {said}; scene.with_ takes values as "
            "the file has them",
            field=name,
        ) from None


def quantities_of(kind: type[Part], name: str) -> Iterator[Quantity]:
    """Yield the quantity that a key of a part is; none where it is something else."""
    if name in kind.model_fields:
        field = kind.model_fields[name]
        said = [*field.metadata]
        for one in get_args(field.annotation):
            said += getattr(one, "__metadata__", ())
        yield from (one for one in said if isinstance(one, Quantity))


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
        value = "[...]" if self.many or isinstance(self, PointList) else "..."
        unit = f', unit = "{self.unit}"' if self.unit else ""
        return f'{{ value = {value}{unit}, source = "..." }}'

    def written(self, value: Any, source: str = "in memory") -> Any:
        """Return a value in memory units as a file has it; what is no number stays as it is."""

        def one(number: Any) -> Any:
            plain = isinstance(number, int | float) and not isinstance(number, bool)
            # A file's degrees come back but for rounding.
            return round(math.degrees(number), 9) if plain and self.unit == "deg" else number

        given = [one(item) for item in value] if isinstance(value, tuple) else one(value)
        return self.form(given, source)

    def form(self, value: Any, source: str) -> dict[str, Any]:
        """Return the form that the file must have, of a value in the file's unit."""
        return {"value": value} | ({"unit": self.unit} if self.unit else {}) | {"source": source}

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
class PointList(Quantity):
    """Annotation of places or directions: a list of lists of ``size`` numbers each.

    In memory a tuple ``(point,)`` of tuples ``(size,)``.
    """

    size: int = 2

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the validation schema."""
        number = core_schema.no_info_after_validator_function(
            self._within, core_schema.float_schema(strict=True)
        )
        point = core_schema.no_info_after_validator_function(
            self._whole, core_schema.tuple_variable_schema(number, strict=False)
        )
        points = core_schema.tuple_variable_schema(point, min_length=1, strict=False)
        return core_schema.no_info_before_validator_function(self._unwrap, points)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the form that the file must have."""
        number = {"type": "number", "minimum": self.low, "maximum": self.high}
        point = {"type": "array", "items": number, "minItems": self.size, "maxItems": self.size}
        return quantity_form(
            {"value": {"type": "array", "items": point, "minItems": 1}}, self.unit
        ) | {
            "description": f"Allowed: lists of {self.size} numbers each, "
            f"{allowed_range(self.low, self.high, self.unit)}."
        }

    def _whole(self, point: tuple[float, ...]) -> tuple[float, ...]:
        if len(point) != self.size:
            raise PydanticCustomError("point_size", "allowed: {n} numbers", {"n": self.size})
        return point

    def written(self, value: Any, source: str = "in memory") -> Any:
        """Return points as a file has them."""
        return self.form([list(point) for point in value], source)


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
