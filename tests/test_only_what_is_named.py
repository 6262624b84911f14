"""What is built is what a scene file names: plugins, shader defines, model inputs.

Asked of every shipped scene and of scenes that name one more optional key each. What is expected is
read from the TOML text alone.
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
from render.scene import Scene, load_scene, scene_text, shipped_scenes

NAMES = shipped_scenes()
MODELS = Path(__file__).parents[1] / "models"
ALWAYS = {"scene", "ply", "diffuse", "uniform", "disk", "hdrfilm", "box"}
"""Meshes, the coating, and lamps as disks before a camera."""


LAMP = """
[[lamps]]
position = { value = [12.0, 3.0, 2.0], unit = "mm", source = "assumed" }
direction = { value = [-1.0, 0.0, 0.0], source = "assumed" }
diameter = { value = 1.0, unit = "mm", source = "assumed" }
profile = PROFILE
"""
BELOW = LAMP.replace("[12.0, 3.0, 2.0]", "[0.0, -8.0, -3.0]").replace("[-1.0, ", "[0.0, ")
BELOW = BELOW.replace("0.0, 0.0]", "0.0, 1.0]")
COSINE = '{ cosine_exponent = { value = 3.0, source = "assumed" } }'
SIGMA = '{ sigma_v = { value = 20.0, unit = "deg", source = "assumed" } }'
ROUGH = '\n[[faces]]\non = ["left"]\nroughness = { value = 0.3, source = "cut" }\n'
PAINT = '\n[[faces]]\non = ["{}"]\n{}\n'
LOBE = """
specular = { value = 0.2, source = "gloss" }
roughness = { value = 0.3, source = "gloss" }
"""
LISTED = '\nlamps = ["green"]'
VARIANTS: dict[str, tuple[str, dict[str, str], str]] = {
    "one rougher face": ("digit", {}, ROUGH),
    "one smooth face": ("digit", {}, ROUGH.replace("0.3", "0.0")),
    "smooth pad": ("digit", {"roughness = { value = 0.1": "roughness = { value = 0.0"}, ""),
    "black face": ("digit", {}, PAINT.format("left", "black = true")),
    "white face": ("digit", {}, PAINT.format("left", 'white = { value = 0.8, source = "paint" }')),
    "mirror": ("digit", {}, PAINT.format("left", 'mirror = { value = 0.9, source = "foil" }')),
    "black face beside a diffuser": ("finger20", {"schema = 1": "schema = 2"},
                                     PAINT.format("base", "black = true")),
    "Gaussian rows": ("digit", {'"lambertian"': SIGMA}, ""),
    "a power of the cosine": ("digit", {'"lambertian"': COSINE}, ""),
    "a lamp from a list": ("digit", {'"green", "red"]': '"green", "red", "green"]'},
                           LAMP.replace("PROFILE", '"lambertian"')),
    "a lamp below fibers": (
        "finger20",
        {"schema = 1": "schema = 2", 'right = "green"': 'right = "green"' + LISTED},
        BELOW.replace("PROFILE", SIGMA),
    ),
    "fisheye": ("digit", {"columns = 240": 'lens = "fisheye"\ncolumns = 240'}, ""),
    "bent": ("digit", {"value = [0.0], ": "value = [0.0, 30.0], "}, ""),
    "a lobe of the skin": ("digit", {"[coating]": "[coating]" + LOBE}, ""),
    "no light in the lobe": ("digit", {"[coating]": "[coating]" + LOBE.replace("0.2", "0.0")}, ""),
    "pad of air": ("digit", {"index = { value = 1.49": "index = { value = 1.0"}, ""),
    "diffuser on one edge": ("finger20", {"schema = 1": "schema = 2",
                                          "[diffuser]": '[diffuser]\non = ["left"]'}, ""),
    "tolerances": ("finger20", {}, """
[tolerances]
led_power = { distribution = "normal", deviation = 0.1, unit = "relative", source = "data" }
"""),
    "free values": ("finger20", {}, """
[free]
reduced_scattering = { value = [0.7, 1.4], unit = "1/mm", source = "silicones" }
"""),
}  # fmt: skip
"""Base, what is replaced in its text, and what is added to it."""


def text_of(name: str) -> str:
    if name not in VARIANTS:
        return scene_text(name)
    base, replaced, added = VARIANTS[name]
    text = scene_text(base)
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    return text + added


def named(name: str) -> dict[str, Any]:
    return tomllib.loads(text_of(name))


def loaded_scene(name: str, folder: Path) -> Scene:
    if name not in VARIANTS:
        return load_scene(name)
    (folder / "variant.toml").write_text(text_of(name))
    return load_scene(folder / "variant.toml")


def profiles(content: dict[str, Any]) -> list[Any]:
    """Return the profile of every row and listed lamp of a scene file."""
    fibers = [{"sigma_v": content["fibers"]["sigma_v"]}] if "fibers" in content else []
    return fibers + [
        lamp["profile"] for kind in ("rows", "lamps") for lamp in content.get(kind, ())
    ]


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
    if content["coating"].get("specular", {"value": 0.0})["value"] > 0:
        found |= {"blendbsdf", "roughconductor"}
    return found | {
        "fiber" if is_gaussian(part) else "measured_light" for part in profiles(content)
    }


@pytest.mark.parametrize("name", [*NAMES, *VARIANTS])
def test_level_2_loads_the_plugins_that_the_file_names(
    name: str, mono: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.optics.lit_scene import lit_scene

    scene, loaded = loaded_scene(name, tmp_path), []
    monkeypatch.setattr(mono, "load_dict", lambda content, **_: loaded.append(content))
    lamps = scene.lamp_count
    for bend in scene.bending.angles:
        lit_scene(scene, np.full(lamps, np.pi / 2), np.ones(lamps), bend, width=4, height=4)
    for content in loaded:
        assert set(plugin_names(content)) == expected_plugins(named(name))


def expected_defines(content: dict[str, Any], bent: bool, program: str) -> set[str]:
    found = {"SOFT_RADIUS"} | ({"CURVED"} if "skin" in content else set())
    found |= {"BENT"} if bent else set()
    found |= set() if program == "points" else {"FACES"}
    if program == "sight":
        return found | ({"FISHEYE"} if content["camera"].get("lens") == "fisheye" else set())
    found |= {"CHANNELS", "POINT_COLUMNS", "POINT_TEXELS", "EMISSION_TEXELS"}
    found |= {"PIXELS"} if program == "pixels" else set()
    milky = content["diffuser"].get("on", ["left", "tip", "right"]) if "diffuser" in content else ()
    fibers = [edge for edge in ("left", "tip", "right") if content.get("fibers", {}).get(edge)]
    edges = {*fibers, *(row["edge"] for row in content.get("rows", ()))}
    found |= {"GLOW"} if edges & set(milky) else set()
    if "lamps" in content or edges - set(milky):
        found |= {"BEAM"}
        # One width of Gaussian beams is a uniform of the shader.
        shapes = profiles(content)
        widths = {part["sigma_v"]["value"] for part in shapes if is_gaussian(part)}
        if len(widths) != 1 or not all(map(is_gaussian, shapes)):
            found |= {"PROFILES"}
    return found | (
        {"METAL"} if any("mirror" in part for part in content.get("faces", ())) else set()
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMES, *VARIANTS])
def test_the_shader_has_the_branches_that_the_file_names(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled: list[tuple[tuple[str, ...], dict[str, str]]] = []

    def recorded(*parts: str, defines: dict[str, str]) -> str:
        compiled.append((parts, defines))
        return source(*parts, defines=defines)

    monkeypatch.setattr(render.preview.lights, "RAYS", 2000)
    monkeypatch.setattr(render.preview.passes, "source", recorded)
    scene = loaded_scene(name, tmp_path)
    phi, power = np.full(scene.lamp_count, np.pi / 2), np.ones((scene.lamp_count, 3))
    with Preview(scene, cache=tmp_path) as preview:
        for bend in scene.bending.angles:
            preview.transport(phi[:1], np.array([bend]))
            preview.picture(phi, power, bend, 4, 4)
    lobe = named(name)["coating"].get("specular", {"value": 0.0})["value"] > 0
    # Patches get irradiance of a skin with a lobe as well, which needs none.
    with_lobe: list[set[str]] = [{"LOBE"}] if lobe else [set()]
    ways = {"sight": with_lobe, "pixels": with_lobe, "points": [set(), *with_lobe]}
    kinds = {
        (
            "sight" if "sight.frag" in parts else "pixels" if "PIXELS" in defines else "points",
            *sorted(defines),
        )
        for parts, defines in compiled
    }
    assert kinds == {
        (program, *sorted(expected_defines(named(name), bend > 0, program) | way))
        for bend in scene.bending.angles
        for program in ("sight", "pixels", "points")
        for way in ways[program]
    }


@pytest.mark.parametrize("name", [name for name in NAMES if (MODELS / name).is_dir()])
def test_the_model_has_the_inputs_that_the_file_leaves_open(name: str) -> None:
    session = onnxruntime.InferenceSession(str(MODELS / name / "checker.onnx"))
    inputs = {entry.name for entry in session.get_inputs()}
    material = {"material"} if "free" in named(name) else set()
    assert inputs == {"phi", "power", "bend"} | material
