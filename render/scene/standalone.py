"""A scene with every file that it names, so that a copy of them is read again from there alone.

A scene file may name a CSV file of lamps, and it or that file may name measured profiles, and the
meshes of its skin, each relative to the scene file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from render.arguments import as_target
from render.errors import SceneError
from render.files import read_bytes, write_bytes
from render.scene.lamps_file import LampLines
from render.scene.scene_file import as_scene, scene_from_text, written_of
from render.scene.schema import Scene
from render.small_table import table_text

OUTSIDE = "files"
"""Folder of the copies of what lies elsewhere than beside the scene file or below."""


@dataclass(frozen=True)
class StandaloneScene:
    """A scene file's text as it was read, and the bytes of its files by their relative names.

    ``origin`` is the path that it was read from, or a shipped name. In ``text`` and in the files
    nothing is changed but names that lead elsewhere.
    """

    origin: str
    text: str
    files: Mapping[str, bytes]

    def write(self, path: Path) -> None:
        """Write the scene to ``path``, and beside it the files that it names; what is there stays.

        The scene comes last: where it lies, its files do.
        """
        for file, content in self.contents(path).items():
            if not file.is_file() or file.read_bytes() != content:
                write_bytes(file, content)

    def contents(self, path: Path) -> dict[Path, bytes]:
        """Return what `write` writes, the scene last."""
        files = {path.parent / name: content for name, content in self.files.items()}
        return files | {path: self.text.encode()}


def standalone(scene: Scene | str | Path) -> StandaloneScene:
    """Return a scene's text, as it was when it was read, with all the files that it names.

    Raises:
        SceneError: the scene is none, or has no file, or a name that leads elsewhere is written in
            another way than ``file = "..."``.
    """
    written = written_of(as_scene(scene))
    if written.text is None:
        raise SceneError(
            f"{written.origin} has no file that could be kept: write one and load that",
            field="scene",
        )
    text, raw, folder = written.text, written.content, written.folder
    table = raw.get("lamps_file")
    listed = LampLines.read(folder, table).lamps if table is not None else ()
    bodies = [raw.get("skin", {}), *raw.get("states", ())]
    meshes = [body["mesh"]["file"] for body in bodies if "mesh" in body]
    named = [*_profiles(raw.get("rows", ())), *_profiles(raw.get("lamps", ()))]
    named = list(dict.fromkeys([*named, *meshes]))
    names = dict.fromkeys([*named, *_profiles(listed)])
    kept = {name: _kept_name(name, number) for number, name in enumerate(names)}
    files = {kept[name]: read_bytes(folder / name) for name in names}
    if table is not None:
        content = table_text(folder / table)
        for name in _profiles(listed):
            alone = rf"(?<![^,;\s\"]){re.escape(name)}(?![^,;\s\"])"
            content = re.sub(alone, kept[name].replace("\\", r"\\"), content)
        kept[table] = _kept_name(table, len(names))
        files[kept[table]] = content.encode()
    for name in named:
        text = _renamed(text, "file", name, kept[name])
    if table is not None:
        text = _renamed(text, "lamps_file", table, kept[table])
    return StandaloneScene(written.origin, text, files)


def rewritten(scene: Scene, comment: str, **keys: Any) -> Scene:
    """Return ``scene`` as read from a text of its own, with a ``comment`` and other plain ``keys``.

    A scene that `Scene.with_` changed has no text; this one can be kept with its files.

    Raises:
        SceneError: the scene was made in memory from another one, or cannot be written.
    """
    # tomlkit is no part of the base install.
    from render.scene.schema.toml_document import content_text

    written = written_of(scene)
    text = content_text(written.content | keys, comment)
    again = scene_from_text(text, written.origin, written.folder)
    if again.hash != scene.hash:
        raise SceneError(
            f"{scene.name} cannot be written as a file without a change: write the values into its "
            "own file",
            field="scene",
        )
    return again


def save_scene(path: str | Path, scene: Scene | str | Path) -> None:
    """Write the file of ``scene`` to ``path``, and beside it those that it names.

    Raises:
        SceneError: ``path`` is a folder, or the scene has no file, see `standalone`.
    """
    standalone(scene).write(as_target(path, "path", SceneError))


def _profiles(lamps: Any) -> Iterator[str]:
    for lamp in lamps:
        if isinstance(lamp["profile"], dict) and "file" in lamp["profile"]:
            yield lamp["profile"]["file"]


def _kept_name(name: str, number: int) -> str:
    path = PurePath(name)
    if path.is_absolute() or ".." in path.parts:
        return f"{OUTSIDE}/{number}-{path.name}"
    return name


def _renamed(text: str, key: str, old: str, new: str) -> str:
    """Return the text of a TOML file in which ``key`` names another file."""
    if old == new:
        return text
    named = re.compile(rf"(\b{key}\s*=\s*)([\"']){re.escape(old)}\2")
    changed, count = named.subn(lambda found: f'{found[1]}"{new}"', text)
    if not count:
        raise SceneError(
            f'{key} = {old} lies outside of the scene\'s folder: write it as {key} = "{old}", or '
            "put the file beside the scene",
            field=key,
        )
    return changed
