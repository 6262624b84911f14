"""A number of the scene file that a study varies: its key, its values, and the sensor with each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optimize.placement import SearchSpace
from render.arguments import refuse
from render.errors import SceneError
from render.refused_values import did_you_mean
from render.scene import OFF, Scene
from render.scene.scene_file import written_of

MOST_VALUES, MOST_SENSORS = 64, 4096
"""Values of one dimension, and combinations of all that are looked at."""
UNSAID = {"camera.shots": (1, "")}
"""Numbers, with their units, that a file says by leaving them out; schema 1 has none of them."""
MEASURES = (
    "schema", "name", "colors", "sites", "indenter", "bending", "states", "baseline", "constraints",
    "tolerances", "free",
)  # fmt: skip
"""Parts of a file that say by what a sensor is judged: a study holds them as they are."""
LIMITS = {
    "search.lamps": "lamps", "search.runs": "runs", "search.current": "", "search.price": "",
}  # fmt: skip
"""Numbers that allow more designs the larger they are, the sensor staying the same; what they
count."""
COSTS = (*LIMITS, "camera.shots")
"""Numbers of which a builder wants little."""
SEARCH = "search"
"""Section of the limits, whose other numbers say where lamps may sit."""
Values = tuple[float, ...]
"""Of all dimensions of a sensor, in the file's units."""
THICKNESS = "pad.thickness"
SOURCE = "varied by tactilux explore --vary"
FORM = "KEY=LOW:HIGH:STEP or KEY=A,B,C, such as pad.thickness=3:6:0.5"


@dataclass(frozen=True)
class Dimension:
    """A number of a scene file and the values that it takes, in the file's unit.

    Arguments:
        key: as it is asked for, ``rows.height`` for that of every row.
        places: keys in the file that take the value.
        unit: of the file, empty for pure numbers.
        values: ascending.
        present: what the file says.
    """

    key: str
    places: tuple[str, ...]
    unit: str
    values: tuple[float, ...]
    present: float

    @property
    def is_limit(self) -> bool:
        """Whether more of it only allows more designs."""
        return self.key in LIMITS

    @property
    def is_cost(self) -> bool:
        """Whether a builder wants little of it."""
        return self.key in COSTS

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        unit = LIMITS.get(self.key) or self.unit
        return f"{value:g} {unit[:-1] if value == 1 and self.is_limit else unit}".rstrip()

    def changes(self, value: float) -> dict[str, Any]:
        """Return what `Scene.with_` takes for the value."""
        if isinstance(self.present, int):
            newer = UNSAID.keys() & {*self.places} or self.key.startswith(f"{SEARCH}.")
            return ({"schema": 2} if newer else {}) | dict.fromkeys(self.places, int(value))
        return {place: {"value": value, "source": SOURCE} for place in self.places}


def dimension_of(scene: Scene, text: str) -> Dimension:
    """Return the dimension that ``KEY=LOW:HIGH:STEP`` or ``KEY=A,B,C`` says.

    Raises:
        SceneError: names key and value, what is allowed, and the nearest key.
    """
    key, equals, said = (part.strip() for part in text.partition("="))
    if not equals or not key or not said:
        raise SceneError(f"vary = {text}, allowed: {FORM}", field="vary")
    return dimension(scene, key, _values(key, said))


def dimensions_of(scene: Scene, vary: Mapping[str, str | Sequence[float]]) -> list[Dimension]:
    """Return the dimensions that a program names: values, or a text, by keys.

    Raises:
        SceneError: as `dimension_of` and `dimension` do, or ``vary`` is no such mapping.
    """
    if not isinstance(vary, Mapping) or not vary:
        refuse(vary, "vary", 'values by keys, such as {"pad.thickness": [3, 4]}', SceneError)
    found = []
    for key, said in vary.items():
        if isinstance(said, str):
            found.append(dimension_of(scene, f"{key}={said}"))
            continue
        values = said.tolist() if isinstance(said, np.ndarray) else said
        if not isinstance(values, list | tuple | range):
            refuse(said, f"vary[{key!r}]", "a list of numbers, or low:high:step", SceneError)
        found.append(dimension(scene, str(key), values))
    return found


def dimension(scene: Scene, key: str, values: Sequence[float]) -> Dimension:
    """Return the dimension of a key and its values.

    Raises:
        SceneError: the scene's file has no such number, several that differ, or values are none.
    """
    found = numbers_of(scene)
    places = [place for place in found if key in {place, *_short_forms(scene, place)}]
    if not places:
        known = [*found, *(form for place in found for form in _short_forms(scene, place))]
        meant = did_you_mean(key, known)
        allowed = "" if meant else f", allowed: {', '.join(dict.fromkeys(known))}"
        why = f"belongs to what {scene.name} is judged by" if key.split(".")[0] in MEASURES else (
            f"is no number that the file of {scene.name} says"
        )  # fmt: skip
        raise SceneError(f"{key} {why}{meant or allowed}", field=f"vary.{key}")
    present = {found[place][0] for place in places}
    if len(present) > 1:
        listed = ", ".join(f"{place} = {found[place][0]:g}" for place in places)
        raise SceneError(
            f"{key} has several values ({listed}), allowed: one of these", field=f"vary.{key}"
        )
    first, unit = found[places[0]]
    checked = [_checked(key, value, whole=isinstance(first, int)) for value in values]
    kept = tuple(sorted(dict.fromkeys(checked)))
    if not 1 <= len(kept) <= MOST_VALUES:
        raise SceneError(
            f"{key} takes {len(kept)} values, allowed: 1 to {MOST_VALUES}; take a wider step",
            field=f"vary.{key}",
        )
    return Dimension(key, tuple(places), unit, kept, first)


def numbers_of(scene: Scene) -> dict[str, tuple[float, str]]:
    """Return the single numbers of a scene's file by their keys, each with its unit.

    Limits that the file does not say are there with what they are without it: as many lamps as the
    baseline lights, and a run for each.

    Raises:
        SceneError: the scene was made in memory from another one.
    """
    content = written_of(scene).content
    lit = sum(color != OFF for color in scene.baseline_colors())
    said = {
        key: found
        for name, part in content.items()
        if name not in MEASURES
        for key, found in _numbers(part, name)
    }
    usual = UNSAID | dict.fromkeys(("search.lamps", "search.runs"), (lit, ""))
    return said | {key: said.get(key, value) for key, value in usual.items()}


class Variants:
    """The sensors of all combinations of the values of some dimensions.

    Raises:
        SceneError: values make no valid sensor, whatever the others are; all of them at once.
    """

    def __init__(
        self,
        scene: Scene,
        dimensions: Sequence[Dimension],
        *,
        lamps_follow: bool = False,
        space: SearchSpace | None = None,
    ) -> None:
        """Read every combination as a scene file is read.

        With ``lamps_follow`` lamps keep their height as a part of a thickness that is varied.
        ``space`` is what may be chosen on each sensor; what its file says unless given.
        """
        self.scene, self.dimensions = scene, tuple(dimensions)
        self.lamps_follow, self.space = lamps_follow, space or SearchSpace()
        self.place = self.space.places_on(scene)
        self._check_search()
        if lamps_follow and not any(THICKNESS in one.places for one in dimensions):
            raise SceneError(
                f"lamps follow {THICKNESS}, which is not varied: vary it, or let lamps stay",
                field="lamps_follow",
                option="--lamps-follow",
            )
        keys = [place for one in dimensions for place in one.places]
        if twice := sorted({key for key in keys if keys.count(key) > 1}):
            raise SceneError(f"{twice[0]} is varied twice, allowed: once", field="vary")
        self.count = math.prod(len(one.values) for one in dimensions)
        if not dimensions or self.count > MOST_SENSORS:
            raise SceneError(
                f"the values make {self.count:,} sensors, allowed: at most {MOST_SENSORS:,}; take "
                "wider steps",
                field="vary",
            )
        self.present = tuple(float(one.present) for one in dimensions)
        self._present = self.searched(scene)
        self._scenes: dict[Values, Scene] = {}
        self._with_places: dict[Values, Scene] = {}
        refused: dict[Values, str] = {}
        for values in itertools.product(*(one.values for one in dimensions)):
            try:
                self._scenes[values] = self._read(values)
            except SceneError as error:
                refused[values] = str(error)
        self._check(refused)
        if set(self._scenes) == {self.present}:
            now = self.shown(self.present)
            raise SceneError(
                f"{now} is what {scene.name} has, allowed: another value of {dimensions[0].key}",
                field=f"vary.{dimensions[0].key}",
            )

    def __contains__(self, values: Values) -> bool:
        """Return whether the values make a sensor."""
        return values in self._scenes

    def __iter__(self) -> Iterator[tuple[float, ...]]:
        """Yield the values of all sensors."""
        return iter(self._scenes)

    def __len__(self) -> int:
        """Return the number of sensors."""
        return len(self._scenes)

    def at(self, values: Values) -> Scene:
        """Return the sensor of ``values`` with its places, as its lights are searched."""
        if values == self.present:
            return self._present
        if values not in self._with_places:
            self._with_places[values] = self.searched(self._scenes[values])
        return self._with_places[values]

    def searched(self, scene: Scene) -> Scene:
        """Return a sensor with the places of its lamps, as many lit as may be."""
        return self.space.on(scene)

    @property
    def one_sensor(self) -> bool:
        """Whether only limits are varied, so that light is the same everywhere."""
        return all(one.is_limit for one in self.dimensions)

    def within(self, values: Values) -> Iterator[Values]:
        """Yield the values whose designs are all allowed at ``values``: of limits no larger."""
        for other in {*self._scenes, self.present}:
            pairs = zip(self.dimensions, other, values, strict=True)
            if all(low == high or (one.is_limit and low < high) for one, low, high in pairs):
                yield other

    def shown(self, values: Values) -> str:
        """Return values with their units: ``4 mm``, or of several dimensions with their keys."""
        pairs = [*zip(self.dimensions, values, strict=True)]
        if len(pairs) == 1:
            return self.dimensions[0].shown(values[0])
        return ", ".join(f"{one.key} {one.shown(value)}" for one, value in pairs)

    def changes(self, values: Values) -> dict[str, Any]:
        """Return what `Scene.with_` takes for ``values``."""
        pairs = [*zip(self.dimensions, values, strict=True)]
        moved = {}
        for one, value in pairs if self.lamps_follow else ():
            if THICKNESS in one.places:
                moved = _moved_lamps(written_of(self.scene).content, value / one.present)
        varied = {key: change for one, value in pairs for key, change in one.changes(value).items()}
        return moved | varied

    def _read(self, values: Values) -> Scene:
        return self.scene if values == self.present else self.scene.with_(**self.changes(values))

    def _check_search(self) -> None:
        """Refuse numbers of a search that would change nothing."""
        for one in self.dimensions:
            given = {"search.lamps": "lamps", "camera.shots": "shots"}.get(one.key)
            if given is not None and getattr(self.space, given) is not None:
                raise SceneError(
                    f"{one.key} is varied and {given} = {getattr(self.space, given)} as well, "
                    "allowed: one of both",
                    field=given,
                    option=f"--{given}",
                )
            counts = one.key.startswith((*COSTS, f"{SEARCH}.counts"))
            rails = one.key.startswith(f"{SEARCH}.") and not counts
            if rails and not self.place:
                raise SceneError(
                    f"{one.key} changes nothing while no lamp may sit elsewhere, allowed: with "
                    "places to choose from",
                    field=f"vary.{one.key}",
                    option="--vary with --place",
                )

    def _check(self, refused: Mapping[tuple[float, ...], str]) -> None:
        """Refuse values that no combination makes a sensor of."""
        told = []
        for number, one in enumerate(self.dimensions):
            fits = {values[number] for values in self._scenes}
            bad = [value for value in one.values if value not in fits]
            if bad:
                why = next(text for values, text in refused.items() if values[number] == bad[0])
                listed = ", ".join(f"{value:g}" for value in bad)
                good = [value for value in one.values if value in fits]
                allowed = f"; of these values fit {_range(good)}" if good else ""
                why = why.partition("is not a valid scene: ")[2] or why
                follow = ""
                stay = THICKNESS in one.places and not self.lamps_follow
                if stay and "lies above the pad" in why:
                    follow = ", and lamps_follow moves lamps with the thickness"
                values = f"{one.key} = {listed} {one.unit}".rstrip()
                told.append(f"{values} makes no valid sensor ({why}){allowed}{follow}")
        if told:
            option = "--vary with --lamps-follow" if "lamps_follow" in told[0] else "--vary"
            raise SceneError("; ".join(told), field="vary", option=option)


def _moved_lamps(content: Mapping[str, Any], ratio: float) -> dict[str, Any]:
    """Return changes that move the lamps beside the pad up or down with its thickness."""

    def scaled(height: float) -> float:
        return float(f"{height * ratio:.12g}") if height > 0.0 else height

    changes: dict[str, Any] = {}
    if "fibers" in content:
        changes["fibers.height"] = scaled(content["fibers"]["height"]["value"])
    for number, row in enumerate(content.get("rows", ())):
        changes[f"rows.{number}.height"] = scaled(row["height"]["value"])
    for number, lamp in enumerate(content.get("lamps", ())):
        x, y, z = lamp["position"]["value"]
        changes[f"lamps.{number}.position"] = [x, y, scaled(z)]
    source = f"{SOURCE}: the same part of the pad's thickness as before"
    return {key: {"value": value, "source": source} for key, value in changes.items()}


def _range(values: Sequence[float]) -> str:
    ends = f"{values[0]:g}", f"{values[-1]:g}"
    return ends[0] if len(values) == 1 else " to ".join(ends)


def _numbers(part: Any, key: str) -> Iterator[tuple[str, tuple[float, str]]]:
    """Yield keys and values of the single numbers in a part of a file, with their units."""
    if isinstance(part, Mapping):
        if "value" in part and "source" in part:
            if _is_number(part["value"]):
                yield key, (float(part["value"]), str(part.get("unit", "")))
            return
        for name, inside in part.items():
            yield from _numbers(inside, f"{key}.{name}")
    elif isinstance(part, list):
        for number, inside in enumerate(part):
            yield from _numbers(inside, f"{key}.{number}")
    elif isinstance(part, int) and not isinstance(part, bool):
        yield key, (part, "")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short_forms(scene: Scene, place: str) -> Iterator[str]:
    """Yield other names of a key: ``rows.left.gap`` and ``rows.gap`` for ``rows.0.gap``."""
    table, _, rest = place.partition(".")
    number, _, name = rest.partition(".")
    if not number.isdecimal():
        return
    yield f"{table}.{name}"
    entry = written_of(scene).content[table][int(number)]
    if "edge" in entry:
        yield f"{table}.{entry['edge']}.{name}"


def _values(key: str, said: str) -> list[float]:
    """Return the values of ``LOW:HIGH:STEP`` or ``A,B,C``."""
    parts = said.split(":")
    if len(parts) == 1:
        return [_number(key, text) for text in said.split(",")]
    if len(parts) != 3:
        raise SceneError(f"{key}={said}, allowed: {FORM}", field=f"vary.{key}")
    low, high, step = (_number(key, text) for text in parts)
    if not (step > 0.0 and low <= high):
        raise SceneError(
            f"{key}={said}, allowed: LOW at most HIGH, and a STEP above 0", field=f"vary.{key}"
        )  # fmt: skip
    count = (high - low) / step
    if count > MOST_VALUES:
        raise SceneError(
            f"{key}={said} has {count + 1:,.0f} values, allowed: at most {MOST_VALUES}; take a "
            "wider step",
            field=f"vary.{key}",
        )
    # Steps of 0.1 are those that people mean: 12 digits drop what binary fractions add.
    return [float(f"{low + step * number:.12g}") for number in range(math.floor(count + 1e-9) + 1)]


def _number(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SceneError(
            f"{key}={text.strip()}, allowed: finite numbers, as in {FORM}", field=f"vary.{key}"
        )
    return value


def _checked(key: str, value: Any, *, whole: bool) -> float:
    """Return a value that a program gave as a float; counts are whole."""
    if not _is_number(value) or not math.isfinite(value):
        raise SceneError(f"{key} = {value!r}, allowed: finite numbers", field=f"vary.{key}")
    if whole and value != int(value):
        raise SceneError(f"{key} = {value:g}, allowed: whole numbers", field=f"vary.{key}")
    return float(value)
