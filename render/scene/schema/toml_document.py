"""Scene files edited as text, so that comments and sources stay."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, SingleKey, Table

from render.scene.lamps_file import LampLines
from render.scene.scene_file import written_of
from render.scene.schema import Scene


def content_text(content: Mapping[str, Any], comment: str = "") -> str:
    """Return a scene file of ``content`` below a ``comment``, each value on a line.

    >>> print(content_text({"schema": 2, "pad": {"index": {"value": 1.4, "source": "x"}}}))
    schema = 2
    <BLANKLINE>
    [pad]
    index = { value = 1.4, source = "x" }
    <BLANKLINE>
    """
    document = tomlkit.document()
    listed = {key: part for key, part in content.items() if _is_list_of_tables(part)}
    parts = {key: part for key, part in content.items() if isinstance(part, Mapping)}
    for key, value in content.items():
        if key not in {*listed, *parts}:
            document.add(key, in_line(value))
    for key, part in parts.items():
        if len(document.body):
            document.add(tomlkit.nl())
        document.add(key, _table(part))
    for key, entries in listed.items():
        tables = tomlkit.aot()
        for entry in entries:
            tables.append(lamp_table(entry))
        document.add(tomlkit.nl())
        document.add(key, tables)
    return text_of(document, comment)


def listed_document(scene: Scene) -> tomlkit.TOMLDocument:
    """Return the file of ``scene``, of schema 2, with all lamps that are listed as ``[[lamps]]``.

    Raises:
        SceneError: the scene has no file.
    """
    written = written_of(scene)
    text = tomlkit.dumps(written.content) if written.text is None else written.text
    document = tomlkit.parse(text)
    document["schema"] = 2
    named = document.pop("lamps_file", None)
    listed = document.get("lamps", [])
    if named is not None:
        listed = LampLines.read(written.folder, str(named)).lamps
    if not isinstance(listed, AoT):
        document.pop("lamps", None)
        set_lamps(document, [dict(lamp) for lamp in listed])
    return document


def set_lamps(document: tomlkit.TOMLDocument, lamps: list[Any]) -> None:
    """Make ``lamps`` the listed ones: tables of the file, or plain content."""
    if not lamps:
        document.pop("lamps", None)
        return
    tables = tomlkit.aot()
    for lamp in lamps:
        tables.append(lamp if isinstance(lamp, Table) else lamp_table(lamp))
    document["lamps"] = tables


def lamp_table(lamp: Mapping[str, Any]) -> Table:
    """Return one entry of ``[[lamps]]``, a line for each key and an empty one after them."""
    table = _table(lamp)
    table.add(tomlkit.nl())
    return table


def _table(part: Mapping[str, Any]) -> Table:
    table = tomlkit.table()
    for key, value in part.items():
        table.add(key, in_line(value))
    return table


def _is_list_of_tables(part: Any) -> bool:
    return isinstance(part, list) and bool(part) and all(isinstance(one, Mapping) for one in part)


def in_line(value: Any) -> Any:
    """Return plain content as TOML on one line, as scene files have it."""
    return tomlkit.value(_one_line(value))


def _one_line(value: Any) -> str:
    if isinstance(value, Mapping):
        entries = (f"{SingleKey(key).as_string()} = {_one_line(one)}" for key, one in value.items())
        return f"{{ {', '.join(entries)} }}" if value else "{}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_one_line, value)) + "]"
    return str(tomlkit.item(value).as_string())


def text_of(document: tomlkit.TOMLDocument, head: str = "") -> str:
    """Return a file's text below the comment ``head``, with no more than one empty line between."""
    comment = "".join(f"# {line}\n" for line in head.splitlines())
    return comment + re.sub(r"\n{3,}", "\n\n", tomlkit.dumps(document))


def table_of(document: tomlkit.TOMLDocument, name: str) -> Any:
    """Return a table of the file, a new one where it has none."""
    if name not in document:
        document[name] = tomlkit.table()
    return document[name]


def body_of(document: tomlkit.TOMLDocument, key: str) -> dict[str, Any]:
    """Return diameter, profile and whether it turns of a lamp, as its file says them.

    ``key`` is that of `PlacedLamp`: ``fibers.left``, ``rows.0`` or ``lamps.2``.
    """
    kind, place = key.split(".")
    if kind == "fibers":
        part = document["fibers"].unwrap()
        profile = {name: part[name] for name in ("sigma_v", "half_angle") if name in part}
        return {"diameter": part["diameter"], "profile": profile, "turns": True}
    part = document[kind].unwrap()[int(place)]
    turns = part.get("turns", kind == "rows")
    return {"diameter": part["diameter"], "profile": part["profile"], "turns": turns}
