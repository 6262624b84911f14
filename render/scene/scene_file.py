"""Scene files: read from TOML, with every problem told at once and the source of every value."""

from __future__ import annotations

import copy
import functools
import operator
import re
from collections.abc import Iterator, Mapping
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from render.arguments import refuse
from render.errors import SceneError
from render.files import parse_toml, read_text
from render.refused_values import allowed_words, did_you_mean, in_toml
from render.scene.colors import COLOR_NAME, INK, colors_in
from render.scene.lamps_file import LampLines, RefusedLamps
from render.scene.quantities import MOST_LISTED
from render.scene.schema import SCENE_NAME, Scene, Written
from render.scene.schema.edits import edited, path_of
from render.scene.schema.newer_keys import LAMPS_FILE, instead_of_key, instead_of_value, keys_at
from render.scene.states import REST_REFUSED, STATE_NAME

NAME_OR_PATH = "the name of a shipped scene or the path of a TOML file"
USUAL_INDEX = 1.41
"""Stands in for an index out of range while the rest of a file is looked at."""
MOST_PLACES = 3
"""Of one problem that are named."""
_TEXTS = {
    SCENE_NAME: "1 to 64 of a-z, 0-9, _ and -, the first a letter or a digit",
    STATE_NAME: "1 to 32 of a-z, 0-9, _ and -, the first a letter or a digit",
    COLOR_NAME: "1 to 32 of a-z, 0-9, _ and -, the first a letter",
    INK: "# and six digits 0-9 or a-f",
}
"""What the patterns of a file's texts allow, for people."""


def load_scene(name_or_path: str | Path) -> Scene:
    """Return the validated scene of a shipped name (``finger20``) or a TOML file.

    Raises:
        SceneError: names every problem at once, each with key, value and allowed range.
    """
    text = scene_text(name_or_path)  # refuses what is no path
    return scene_from_text(text, str(name_or_path), Path(name_or_path).parent)


def scene_from_text(text: str, origin: str, folder: Path) -> Scene:
    """Return the validated scene of a TOML text; ``origin`` is what errors call it.

    ``folder`` is where the files lie that it names.

    Raises:
        SceneError: as `load_scene` does.
    """
    return _scene_of_content(_parsed(text, origin), origin, folder, text)


def changed_scene(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return the scene whose file has ``changes``, as `Scene.with_` takes them.

    Raises:
        SceneError: as `Scene.with_` does.
    """
    written = written_of(scene)
    content = written.content
    if any(key.startswith("lamps") and not key.startswith(LAMPS_FILE) for key in changes):
        content, _ = _with_listed_lamps(content, written.folder)
    paths = [path_of(content, key) for key in changes]
    content = edited(content, dict(zip(paths, changes.values(), strict=True)))
    return _scene_of_content(content, f"{scene.name} as changed", written.folder)


def written_of(scene: Scene) -> Written:
    """Return the file that ``scene`` was read from, as it was then.

    Raises:
        SceneError: it has none.
    """
    if scene._written is None:
        raise SceneError(
            f"{scene.name} was made in memory from another scene, and has no file that could be "
            "changed: change that scene first",
            field="scene",
        )
    return scene._written


def _scene_of_content(
    content: dict[str, Any], origin: str, folder: Path, text: str | None = None
) -> Scene:
    raw, lines = _with_listed_lamps(content, folder)
    try:
        context: dict[str, Any] = {
            "colors": colors_in(raw),
            "folder": folder,
            "rest_mesh": _mesh_file(raw),
            "pad_sides": _pad_sides(raw),
        }
        scene = Scene.model_validate(raw, context=context)
        scene._written = Written(content, folder.absolute(), origin, text)
        return scene
    except ValidationError as error:
        problems = _problems(error)
        without = _with_stand_ins(raw, problems, context["colors"][0])
        if without is not None:
            try:
                Scene.model_validate(without, context=context)
            except ValidationError as further:
                problems += _problems(further)
        raise SceneError(
            f"{origin} is not a valid scene: {_told(problems, raw, lines)}",
            field=".".join(str(part) for part in problems[0]["loc"]),
        ) from None


def _problems(error: ValidationError) -> list[Any]:
    """Return what is wrong, once: not what follows from another problem.

    A list all of whose entries are refused is not empty besides, and states of a refused skin are
    not refused besides.
    """
    found: list[Any] = error.errors(include_url=False)
    followed = any(one["loc"][:2] == ("skin", "mesh") for one in found)
    return [
        one
        for one in found
        if not (one["type"] == "too_short" and any(_within(other, one) for other in found))
        and not (one["type"] == REST_REFUSED and followed)
    ]


def _within(problem: Any, whole: Any) -> bool:
    """Return whether a problem is one of an entry of a list that is refused as a ``whole``."""
    place, list_ = problem["loc"], whole["loc"]
    return len(place) > len(list_) and place[: len(list_)] == list_


def _with_stand_ins(raw: dict[str, Any], problems: list[Any], color: str) -> dict[str, Any] | None:
    """Return the file with what geometry does not ask for made right, so that it is looked at too.

    Unknown keys are left out; unknown colors, and materials out of range, have values that are
    allowed. None where anything else is wrong, for then there is no geometry.
    """
    mended: Any = copy.deepcopy(raw)
    for problem in problems:
        *place, last = problem["loc"] or (None,)
        try:
            part = functools.reduce(operator.getitem, place, mended)
            if problem["type"] == "extra_forbidden":
                del part[last]
            elif problem["type"] == "unknown_color":
                part[last] = color
            elif problem["type"] == "out_of_range" and part[last].get("unit", "") in ("", "1/mm"):
                part[last]["value"] = USUAL_INDEX if last == "index" else problem["ctx"]["low"]
            else:
                return None
        except (KeyError, IndexError, TypeError, AttributeError):  # within a choice of types
            return None
    return dict(mended)


def _with_listed_lamps(
    raw: dict[str, Any], folder: Path
) -> tuple[dict[str, Any], LampLines | None]:
    """Return a scene file with the lamps of the CSV file that it names, and their lines."""
    if LAMPS_FILE not in raw:
        return raw, None
    name = raw[LAMPS_FILE]
    others = {key: part for key, part in raw.items() if key != LAMPS_FILE}
    lamps: Any
    if "lamps" in raw:
        lamps = RefusedLamps(": lamps are listed in this file too, allowed: one")
    elif not isinstance(name, str):
        lamps = RefusedLamps(f" = {in_toml(name)}, allowed: the name of a CSV file")
    else:
        try:
            lines = LampLines.read(folder, name)
            return others | {"lamps": list(lines.lamps)}, lines
        except ValueError as error:
            lamps = RefusedLamps(f" = {name}: {error}")
    return others | {"lamps": lamps}, None


def _mesh_file(raw: dict[str, Any]) -> str | None:
    """Return the file of the skin at rest that a scene names, which its states follow."""
    mesh = raw["skin"].get("mesh") if isinstance(raw.get("skin"), dict) else None
    file = mesh.get("file") if isinstance(mesh, dict) else None
    return file if isinstance(file, str) else None


def as_scene(value: Scene | str | Path, name: str = "scene") -> Scene:
    """Return the scene that is given, or that of a shipped name or a TOML file.

    Raises:
        SceneError: as `load_scene` does; ``name`` is that of the argument.
    """
    if isinstance(value, Scene):
        return value
    if not isinstance(value, str | PathLike):
        refuse(value, name, f"a scene, {NAME_OR_PATH}", SceneError)
    return load_scene(value)


def _pad_sides(raw: dict[str, Any]) -> tuple[float, float] | None:
    """Return width and length (mm) of the pad that a scene names, which its meshes have."""
    try:
        width, length = (float(raw["pad"][key]["value"]) for key in ("width", "length"))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return width, length


def sources(scene: Scene | str | Path) -> dict[str, str]:
    """Return the source of every value of a scene, keyed like ``pad.width``."""
    written = written_of(as_scene(scene))
    return dict(_sources(_with_listed_lamps(written.content, written.folder)[0]))


def _sources(content: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield the keys and sources of all values in a part of a scene file; colors have names."""
    if isinstance(content, dict) and "source" in content:
        part, _, name = key.rpartition(".")
        if name == "half_angle":
            told = f"{content['source']} (half_angle {content['value']:g} deg)"
            yield f"{part}.sigma_v", told
        else:
            yield key, str(content["source"])
        return
    parts: Any = content.items() if isinstance(content, dict) else ()
    if isinstance(content, list | tuple):
        parts = enumerate(content)
    for name, part in parts:
        if key == "colors":
            yield f"colors.{part['name']}", str(part["response"]["source"])
        else:
            yield from _sources(part, f"{key}.{name}" if key else str(name))


def shipped_scenes() -> list[str]:
    """Return the names of the scenes that come with tactilux."""
    folder = resources.files("render") / "scenes"
    return sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml"))


def scene_text(name_or_path: str | Path) -> str:
    """Return the TOML text of a shipped scene or a file, as it was written.

    Raises:
        SceneError: there is no such scene, or its file cannot be read.
    """
    if not isinstance(name_or_path, str | PathLike):
        refuse(name_or_path, "name_or_path", NAME_OR_PATH, SceneError)
    text_name = str(name_or_path)
    if text_name in shipped_scenes():
        return (resources.files("render") / "scenes" / f"{text_name}.toml").read_text("utf-8")
    next_step = f"give the path of a TOML file or one of {', '.join(shipped_scenes())}"
    try:
        return read_text(Path(name_or_path))
    except ValueError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            files = [str(file) for file in Path(name_or_path).parent.glob("*.toml")]
            meant = did_you_mean(text_name, [*shipped_scenes(), *files])
            raise SceneError(
                f"there is no scene {text_name!r}: {next_step}{meant}", field="scene"
            ) from None
        raise SceneError(f"{text_name} {error}; {next_step}", field="scene") from None


def _parsed(text: str, origin: str) -> dict[str, Any]:
    try:
        raw = parse_toml(text)
    except ValueError as error:
        raise SceneError(f"{origin} cannot be read as TOML: {error}", field="scene") from None
    long = [f"{key} has {count} entries" for key, count in _long_lists(raw)]
    if long:
        raise SceneError(
            f"{origin} is not a valid scene: {'; '.join(long)}, allowed: at most {MOST_LISTED}",
            field="scene",
        )
    return raw


def _long_lists(content: Any, key: str = "") -> Iterator[tuple[str, int]]:
    """Yield the keys of lists and tables that are too long to be looked at, and their lengths."""
    if isinstance(content, dict | list) and len(content) > MOST_LISTED:
        yield key or "the file", len(content)
        return
    entries: Any = content.items() if isinstance(content, dict) else ()
    for name, part in enumerate(content) if isinstance(content, list) else entries:
        yield from _long_lists(part, f"{key}.{name}" if key else str(name))


def _told(problems: list[Any], raw: Mapping[str, Any], lines: LampLines | None) -> str:
    """Return what is wrong; what is so of several entries of a list is one sentence."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for problem in problems:
        before, place, after = _sentence(problem, raw, lines)
        found.setdefault((before, re.sub(r"\d+", "", place), after), []).append(place)
    sentences = []
    for (before, _, after), places in found.items():
        more = f" and {len(places) - MOST_PLACES} more" if len(places) > MOST_PLACES else ""
        sentences.append(f"{before}{', '.join(places[:MOST_PLACES])}{more}{after}")
    return "; ".join(sentences)


def _sentence(
    problem: Any, raw: Mapping[str, Any], lines: LampLines | None
) -> tuple[str, str, str]:
    """Turn a validation problem into ``key = value: what is wrong and what is allowed``.

    Return what comes before the key, the key, and the rest.
    """
    if isinstance(problem["input"], RefusedLamps):
        return "", problem["input"].where, problem["input"].why
    place, kind = problem["loc"], problem["type"]
    listed = lines is not None and place[:1] == ("lamps",)
    key = lines.key(place) if lines and listed else ".".join(map(str, place))
    if kind == "extra_forbidden":
        return "unknown key ", key, instead_of_key(problem["loc"], raw)
    if kind == "missing":
        return "missing key ", key, " or half_angle" * (place[-1] == "sigma_v")
    message = problem["msg"].removeprefix("Value error, ")
    if kind == "value_error" and not key:
        return lines.named(message) if lines else str(message), "", ""
    value = problem["input"]
    allowed = allowed_words(problem, [*keys_at(problem["loc"])])
    more = instead_of_value(problem, raw)
    if allowed:
        value = value["value"] if kind == "number_or_list" else value
        return "", key, f" = {in_toml(value)}, allowed: {allowed}{more}"
    if isinstance(value, dict) and "value" in value:
        value = " ".join(_plain(value[part]) for part in ("value", "unit") if part in value)
    elif isinstance(value, dict) and set(value) == {"file", "source"}:
        value = value["file"]
    value = _plain(value)
    if kind == "string_pattern_mismatch":
        return "", key, f" = {value}, allowed: {_TEXTS[problem['ctx']['pattern']]}"
    return "", key, f" = {value}: {message}{more}"


def _plain(value: Any) -> str:
    """Return a value as a TOML file has it, a text without its quotes."""
    return value if isinstance(value, str) else in_toml(value)
