"""The scene of a design: a run keeps a copy of its file, and designs find the file by its hash."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from render.errors import SceneError
from render.files import parse_toml, read_text
from render.scene import StandaloneScene, load_scene, shipped_scenes

SCENE, RUN_MODEL = "scene.toml", "model"
"""In the folder of a run: the copy of its scene, and the folder of the model that a night fits."""


def keep_scene(run: Path, scene: StandaloneScene) -> None:
    """Write a scene file into ``run``, with its comments and sources, unless it is there.

    The files that it names come with it, so that ``run`` may go elsewhere alone.
    """
    scene.write(run / SCENE)


def kept_name(scene: StandaloneScene, run: Path) -> str:
    """Return what commands take for a scene that ``run`` keeps, whatever becomes of its file."""
    return scene.origin if scene.origin in shipped_scenes() else str(run / SCENE)


def find_scene(named: str, design: Path, scene_hash: str = "") -> str | None:
    """Return what `load_scene` takes for the scene that the file ``design`` names, or None.

    That is a shipped scene; or a file beside the design or in the working directory, with or
    without ``.toml`` in the name, or whatever its name where it says that it is this scene; or the
    copy in the folder of the run. The first one with ``scene_hash`` is taken, and where none has it
    the first one.
    """
    places = list(dict.fromkeys(_places(named, design)))
    fits = (place for place in places if _hash(place) == scene_hash) if scene_hash else iter(())
    return next(fits, places[0] if places else None)


def _places(named: str, design: Path) -> Iterator[str]:
    """Yield what may be the scene ``named``, the likeliest first."""
    if named in shipped_scenes():
        yield named
    folders = (design.parent, Path())
    for name in (named, f"{named}.toml"):
        yield from (str(folder / name) for folder in folders if (folder / name).is_file())
    for folder in folders:
        yield from (str(file) for file in sorted(folder.glob("*.toml")) if _name(file) == named)
    for folder in (design.parent, design.parent.parent):
        if (folder / SCENE).is_file():
            yield str(folder / SCENE)


def _name(file: Path) -> object:
    try:
        return parse_toml(read_text(file)).get("name")
    except ValueError:
        return None


def _hash(place: str) -> str:
    try:
        return load_scene(place).hash
    except SceneError:
        return ""
