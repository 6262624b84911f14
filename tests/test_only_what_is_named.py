"""Per shipped scene, what is built is what its file names: plugins, shader defines, model inputs.

What is expected is read from the TOML text alone.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import onnxruntime
import pytest

import render.preview.lights
import render.preview.passes
from render.preview import Preview
from render.preview.shader import source
from render.scene import load_scene, scene_text, shipped_scenes

NAMES = shipped_scenes()
MODELS = Path(__file__).parents[1] / "models"
ALWAYS = {"scene", "ply", "diffuse", "uniform", "disk", "hdrfilm", "box"}
"""Meshes, the coating, and lamps as disks before a camera."""


def named(name: str) -> dict[str, Any]:
    return tomllib.loads(scene_text(name))


def profiles(content: dict[str, Any]) -> list[Any]:
    """Return the profile of every row and listed lamp of a scene file."""
    if "fibers" in content:
        return [{"sigma_v": content["fibers"]["sigma_v"]}]
    return [lamp["profile"] for kind in ("rows", "lamps") for lamp in content.get(kind, ())]


def is_gaussian(profile: Any) -> bool:
    return isinstance(profile, dict) and "sigma_v" in profile


def plugin_names(content: Any) -> Iterator[str]:
    """Yield the type of every plugin in a Mitsuba dictionary; references to others are none."""
    if isinstance(content, dict):
        if content.get("type") not in (None, "ref"):
            yield content["type"]
        for part in content.values():
            yield from plugin_names(part)


def expected_plugins(content: dict[str, Any]) -> set[str]:
    found = ALWAYS | {"fisheye" if content["camera"].get("lens") == "fisheye" else "perspective"}
    faces = content.get("faces", ())
    rough = [part["roughness"]["value"] for part in (content["pad"], *faces) if "roughness" in part]
    found |= {"conductor"} if any("mirror" in part for part in faces) else set()
    if content["pad"]["index"]["value"] == 1:
        found |= {"null"}  # the pad is air
    else:
        found |= {"roughdielectric" if alpha > 0 else "dielectric" for alpha in rough}
    if "diffuser" in content:
        found |= {"homogeneous", "hg", "null"}
    return found | {
        "fiber" if is_gaussian(part) else "measured_light" for part in profiles(content)
    }


@pytest.mark.parametrize("name", NAMES)
def test_level_2_loads_the_plugins_that_the_file_names(
    name: str, mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.optics.lit_scene import lit_scene

    scene, loaded = load_scene(name), []
    monkeypatch.setattr(mono, "load_dict", lambda content, **_: loaded.append(content))
    lamps = scene.lamp_count
    for bend in scene.bending.angles:
        lit_scene(scene, np.full(lamps, np.pi / 2), np.ones(lamps), bend, width=4, height=4)
    for content in loaded:
        assert set(plugin_names(content)) == expected_plugins(named(name))


def expected_defines(content: dict[str, Any], bent: bool, picture: bool) -> set[str]:
    found = {"CHANNELS", "POINT_COLUMNS", "EMISSION_TEXELS", "SOFT_RADIUS"}
    rows = content.get("rows", ())
    behind = "diffuser" in content
    if behind:
        found |= {"GLOW"}
    if not behind or "lamps" in content or any(row["edge"] == "base" for row in rows):
        found |= {"BEAM"}
        if not all(map(is_gaussian, profiles(content))):
            found |= {"PROFILES"}
    if picture:
        found |= {"FACES"}
        found |= {"FISHEYE"} if content["camera"].get("lens") == "fisheye" else set()
    found |= {"CURVED"} if "skin" in content else set()
    found |= {"METAL"} if any("mirror" in part for part in content.get("faces", ())) else set()
    return found | ({"BENT"} if bent else set())


@pytest.mark.parametrize("name", NAMES)
def test_the_shader_has_the_branches_that_the_file_names(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled: list[tuple[tuple[str, ...], dict[str, str]]] = []

    def recorded(*parts: str, defines: dict[str, str]) -> str:
        compiled.append((parts, defines))
        return source(*parts, defines=defines)

    monkeypatch.setattr(render.preview.lights, "RAYS", 2000)
    monkeypatch.setattr(render.preview.passes, "source", recorded)
    scene = load_scene(name)
    phi, power = np.full(scene.lamp_count, np.pi / 2), np.ones((scene.lamp_count, 3))
    with Preview(scene, cache=tmp_path) as preview:
        for bend in scene.bending.angles:
            preview.transport(phi[:1], np.array([bend]))
            preview.picture(phi, power, bend, 4, 4)
    assert {("picture.frag" in parts, *sorted(defines)) for parts, defines in compiled} == {
        (picture, *sorted(expected_defines(named(name), bend > 0, picture)))
        for bend in scene.bending.angles
        for picture in (True, False)
    }


@pytest.mark.parametrize("name", [name for name in NAMES if (MODELS / name).is_dir()])
def test_the_model_has_the_inputs_that_the_file_leaves_open(name: str) -> None:
    session = onnxruntime.InferenceSession(str(MODELS / name / "checker.onnx"))
    inputs = {entry.name for entry in session.get_inputs()}
    material = {"material"} if "free" in named(name) else set()
    assert inputs == {"phi", "power", "bend"} | material
