"""Designs that a user names: files, or the directories of runs that found them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from optimize.design import Design, load_layout
from optimize.overnight.result import DESIGNS, NIGHT, OvernightResult
from optimize.report import DESIGN
from render.errors import DesignError
from render.scene import Scene


@dataclass(frozen=True, eq=False)
class NamedDesign:
    """A design, its file and its sensor, and what tables call it."""

    name: str
    file: Path
    scene: Scene
    design: Design


def name_designs(paths: Sequence[Path], scene_name: str | None = None) -> list[NamedDesign]:
    """Return the designs in ``paths``, each with its scene.

    A path is a design file, a layout, or the directory of a run, which stands for the design that
    it hands over. ``scene_name`` is a shipped scene or a file, where the designs' own is not; all
    must then be of it.

    Raises:
        DesignError: a file is bad, or of another scene than the one that is named.
        SceneError: a scene cannot be read.
    """
    files = [design_file(path) for path in paths]
    known: dict[str, Scene] = {}
    found = []
    for file, name in zip(files, _names(paths, files), strict=True):
        scene, design = load_layout(file, scene_name)
        found.append(NamedDesign(name, file, known.setdefault(scene.hash, scene), design))
    return found


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


def _names(paths: Sequence[Path], files: Sequence[Path]) -> list[str]:
    """Return short names that differ: a run's directory, a file's stem, or else the path."""
    short = [
        path.resolve().name if path.is_dir() or file.name == DESIGN else file.stem
        for path, file in zip(paths, (file.parent if file.name == DESIGN else file
                                      for file in files), strict=True)
    ]  # fmt: skip
    many = Counter(short)
    return [name if many[name] == 1 else str(file) for name, file in zip(short, files, strict=True)]
