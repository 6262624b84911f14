"""Designs of one scene that a user names: files, or the directories of runs that found them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from optimize.design import Design, load_layout
from optimize.overnight.result import DESIGNS, NIGHT, OvernightResult
from optimize.report import DESIGN
from render.errors import DesignError
from render.files import read_json
from render.scene import Scene


@dataclass(frozen=True, eq=False)
class NamedDesign:
    """A design, its file, and what tables call it."""

    name: str
    file: Path
    design: Design


def name_designs(
    paths: Sequence[Path], scene_name: str | None = None
) -> tuple[Scene, list[NamedDesign]]:
    """Return the one scene of the designs in ``paths``, and the designs.

    A path is a design file, a layout, or the directory of a run, which stands for the design that
    it hands over. ``scene_name`` is a shipped scene or a file, where the designs' own is not.

    Raises:
        DesignError: a file is bad, or of another scene than the first one.
        SceneError: the scene cannot be read.
    """
    files = [design_file(path) for path in paths]
    _check_hashes(files)
    scene: Scene | None = None
    found = []
    for file, name in zip(files, _names(paths, files), strict=True):
        own, design = load_layout(file, scene_name)
        if scene is not None and own.hash != scene.hash:
            raise _of_two_scenes(file, own.name, own.hash, files[0], scene.name, scene.hash)
        scene = scene or own
        found.append(NamedDesign(name, file, design))
    if scene is None:
        raise DesignError("no design is named: give the files of some", field="design")
    return scene, found


def design_file(path: Path) -> Path:
    """Return the file of the design that the run in ``path`` hands over; a file is its own."""
    if not path.is_dir():
        return path
    if (path / DESIGN).is_file():
        return path / DESIGN
    if (path / NIGHT).is_file():
        return path / DESIGNS / f"{OvernightResult.load(path).winner}.json"
    raise DesignError(
        f"{path} holds no {DESIGN} and no finished night: name a design file, or a directory that "
        "explore, optimize or overnight wrote",
        field="design",
    )


def _check_hashes(files: Sequence[Path]) -> None:
    """Refuse files that say that they are of different scenes, before any scene is looked for."""
    first: tuple[Path, str, str] | None = None
    for file in files:
        content = read_json(file)
        scene, scene_hash = content.get("scene"), content.get("scene_hash")
        if not isinstance(scene_hash, str):
            continue
        first = first or (file, str(scene), scene_hash)
        if scene_hash != first[2]:
            raise _of_two_scenes(file, str(scene), scene_hash, *first)


def _of_two_scenes(
    file: Path, scene: str, scene_hash: str, first: Path, first_scene: str, first_hash: str
) -> DesignError:
    return DesignError(
        f"{file} is for scene {scene}, hash {scene_hash}, and {first} for {first_scene}, hash "
        f"{first_hash}: scores of two scenes cannot be compared, so name designs of one",
        field="scene_hash",
    )


def _names(paths: Sequence[Path], files: Sequence[Path]) -> list[str]:
    """Return short names that differ: a run's directory, a file's stem, or else the path."""
    short = [
        path.resolve().name if path.is_dir() or file.name == DESIGN else file.stem
        for path, file in zip(paths, (file.parent if file.name == DESIGN else file
                                      for file in files), strict=True)
    ]  # fmt: skip
    many = Counter(short)
    return [name if many[name] == 1 else str(file) for name, file in zip(short, files, strict=True)]
