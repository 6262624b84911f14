"""Numbers in scene files carry unit, range and source."""

from __future__ import annotations

import math
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from render.scene import Count, Quantity
from render.scene.quantities import Part, keys_of_schema_2, since_schema_2


class Probe(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    length: Annotated[float, Quantity("mm", 0.5, 20.0)] = 1.0
    angle: Annotated[float, Quantity("deg", -60.0, 60.0)] = 0.0
    ratio: Annotated[float, Quantity("", 0.0, 1.0)] = 0.5
    angles: Annotated[tuple[float, ...], Quantity("deg", 0.0, 180.0, many=True)] = (0.0,)
    number: Annotated[int, Count(1, 64)] = 1


def millimeters(value: object) -> dict[str, object]:
    return {"value": value, "unit": "mm", "source": "assumed"}


def message(**raw: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        Probe(**raw)
    return "; ".join(error["msg"] for error in caught.value.errors())


def test_lengths_stay_and_angles_become_radians() -> None:
    degrees = {"value": 45.0, "unit": "deg", "source": "assumed"}
    probe = Probe(length=millimeters(18), angle=degrees, number=3)
    assert probe.length == 18.0
    assert isinstance(probe.length, float)
    assert probe.angle == math.pi / 4
    assert probe.number == 3


def test_a_list_of_angles_is_converted_one_by_one() -> None:
    probe = Probe(angles={"value": [0, 180], "unit": "deg", "source": "assumed"})
    assert probe.angles == (0.0, math.pi)


def test_an_empty_list_is_refused() -> None:
    assert "at least 1" in message(angles={"value": [], "unit": "deg", "source": "assumed"})


@pytest.mark.parametrize("value", [0.4999, 20.0001, math.nan, math.inf, -math.inf])
def test_values_outside_the_range_are_refused_with_the_whole_range(value: float) -> None:
    assert message(length=millimeters(value)) == "allowed: 0.5 to 20 mm"


@pytest.mark.parametrize("value", [0.5, 20.0])
def test_the_ends_of_the_range_are_allowed(value: float) -> None:
    assert Probe(length=millimeters(value)).length == value


@pytest.mark.parametrize("value", ["18", True, None, [18.0]])
def test_only_numbers_are_numbers(value: object) -> None:
    assert message(length=millimeters(value))


def test_an_enormous_whole_number_is_refused_not_overflowed() -> None:
    assert message(length=millimeters(10**400))


def test_minus_zero_is_zero() -> None:
    probe = Probe(ratio={"value": -0.0, "source": "assumed"})
    assert math.copysign(1.0, probe.ratio) == 1.0


def test_the_unit_must_be_the_expected_one() -> None:
    assert 'unit must be "mm"' in message(length={"value": 1.0, "unit": "cm", "source": "a"})


@pytest.mark.parametrize(
    "raw",
    [
        18.0,
        {"value": 18.0},
        {"value": 18.0, "unit": "mm"},
        {"value": 18.0, "unit": "mm", "source": "assumed", "note": "more"},
    ],
)
def test_the_form_is_value_unit_and_source_and_nothing_else(raw: object) -> None:
    assert '{ value = ..., unit = "mm", source = "..." }' in message(length=raw)


@pytest.mark.parametrize("source", ["", "  ", 7])
def test_every_value_says_where_it_comes_from(source: object) -> None:
    assert 'be "assumed"' in message(length={"value": 1.0, "unit": "mm", "source": source})


@pytest.mark.parametrize("value", [0, 65])
def test_counts_outside_the_range_are_refused_with_the_whole_range(value: int) -> None:
    assert message(number=value) == "allowed: 1 to 64"


@pytest.mark.parametrize("value", [1.0, 1.5, "2", True])
def test_counts_are_whole_numbers(value: object) -> None:
    assert message(number=value)


class Inner(Part):
    old: int
    new: int | None = since_schema_2()


class Outer(Part):
    inner: Inner
    part: Inner | None = since_schema_2()


def test_keys_of_schema_2_are_named_where_a_file_has_them() -> None:
    assert list(keys_of_schema_2(Outer(inner=Inner(old=1)))) == []
    both = Outer(inner=Inner(old=1, new=0), part=Inner(old=1))
    assert list(keys_of_schema_2(both)) == ["inner.new", "part"]
