"""A soft dome in several states as mesh files of one topology, and the scene files that name them.

Corners at rest are moved by formulas, so that where the material went is known without any chart.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from render.arrays import Array
from render.scene import Scene, load_scene
from tests.oracles.skin_bodies import body_under

SIDES, CROWN, RADIUS = (20.0, 24.0), 6.0, 40.0
"""Of the pad, the height of its crown at rest, and the sphere of its skin at rest, mm."""
STEPS = 40
"""Quads along each side of the files."""
PLATE = 5.3
"""Height (mm) of a plate that presses the crown flat."""
LOW = 0.9
"""Part of its height that the low state leaves of the skin everywhere."""


def rest_body(steps: int = STEPS) -> trimesh.Trimesh:
    """Return the dome at rest."""
    return body_under(lambda x, y: CROWN - RADIUS + np.sqrt(RADIUS**2 - x**2 - y**2), SIDES, steps)


def pressed(points: Array, twist: float = 0.0) -> Array:
    """Return where a plate presses skin ``(..., 3)`` mm to: down, aside, around by ``twist``."""
    x, y, z = np.moveaxis(points, -1, 0)
    border = (1 - (2 * x / SIDES[0]) ** 2) * (1 - (2 * y / SIDES[1]) ** 2)
    aside = 0.09 * border * np.exp(-(x**2 + y**2) / 80.0)
    down = 0.15 * np.logaddexp(0.0, (z - PLATE) / 0.15)
    return np.stack(
        [x + aside * x - twist * border * y, y + aside * y + twist * border * x, z - down], axis=-1
    )


def twisted(points: Array) -> Array:
    """Return where a plate that turns takes the skin."""
    return pressed(points, twist=0.05)


def low(points: Array) -> Array:
    """Return skin that sinks straight down."""
    return points * [1.0, 1.0, LOW]


MOVES = {"pressed": pressed, "twisted": twisted, "low": low}
"""The states besides the rest, by their names."""


def moved_body(name: str, steps: int = STEPS) -> trimesh.Trimesh:
    """Return the body in a state: its upper corners moved, its lower ones not."""
    body = rest_body(steps)
    points = np.asarray(body.vertices)
    upper = points[:, 2:] > 0.0
    return trimesh.Trimesh(np.where(upper, MOVES[name](points), points), body.faces, process=False)


def write_files(folder: Path, steps: int = STEPS) -> None:
    """Write the meshes of the rest and of all states."""
    rest_body(steps).export(folder / "rest.stl")
    for name in MOVES:
        moved_body(name, steps).export(folder / f"{name}.stl")


def written(folder: Path, text: str) -> Scene:
    """Return the scene of ``text``, written beside its meshes."""
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def scene_text_of(
    *states: str, mesh: str = "rest.stl", crown: float = CROWN, extra: str = ""
) -> str:
    """Return a scene file: the skin of ``mesh`` and ``states``; ``extra`` is text at its end."""
    text = f"""
        schema = 2
        name = "soft-dome"
        pad.width = {_mm(SIDES[0])}
        pad.length = {_mm(SIDES[1])}
        pad.thickness = {_mm(crown)}
        pad.index = {_number(1.41)}
        pad.roughness = {_number(0.0)}
        coating.albedo = {_number(0.5)}
        skin = {{ shape = "mesh", mesh = {{ file = "{mesh}", source = "CAD" }} }}
        camera.distance = {_mm(22.0)}
        camera.y = {_mm(0.0)}
        camera.field_of_view = {_deg(65.0)}
        camera.columns = 320
        camera.rows = 400
        bending.angles = {_deg([0.0])}
        sites.columns = 3
        sites.rows = 3
        sites.spacing = {_mm(5.0)}
        sites.centre_x = {_mm(0.0)}
        sites.centre_y = {_mm(0.0)}
        indenter.faces = 6
        indenter.slope = {_deg(30.0)}
        indenter.radius = {_mm(0.8)}
        baseline = {{ left = "red", tip = "green", right = "blue" }}
    """
    for edge in ("left", "tip", "right"):
        text += f"""
        [[rows]]
        edge = "{edge}"
        count = 2
        diameter = {_mm(1.0)}
        gap = {_mm(0.6)}
        height = {_mm(1.5)}
        tilt = {_deg(10.0)}
        profile = "lambertian"
        turns = false
        """
    for name in states:
        text += f"""
        [[states]]
        name = "{name}"
        mesh = {{ file = "{name}.stl", source = "simulation" }}
        """
    return "\n".join(line.strip() for line in (text + extra).splitlines())


def round_scene_text(*radii: float, shape: str = "dome", crown: float | None = None) -> str:
    """Return a scene file whose skin is round at rest, and of other ``radii`` in its states."""
    axis = ', axis = "y"' if shape == "arch" else ""
    skin = f'skin = {{ shape = "{shape}", radius = {_mm(RADIUS)}{axis} }}'
    text = scene_text_of()
    old = next(line for line in text.splitlines() if line.startswith("skin ="))
    text = text.replace(old, skin)
    for radius in radii:
        text += f'[[states]]\nname = "r{radius:g}"\nradius = {_mm(radius)}\n'
        text += "" if crown is None else f"thickness = {_mm(crown)}\n"
    return text


def _mm(value: float) -> str:
    return f'{{ value = {value}, unit = "mm", source = "assumed" }}'


def _deg(value: float | list[float]) -> str:
    return f'{{ value = {value}, unit = "deg", source = "assumed" }}'


def _number(value: float) -> str:
    return f'{{ value = {value}, source = "assumed" }}'
