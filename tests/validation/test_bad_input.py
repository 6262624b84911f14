"""What cannot be rendered says why and what to change, also through ``mi.render``.

Both ``integrator.render`` and ``mi.render`` raise the typed error, and nothing around it.
"""

from __future__ import annotations

import re
import traceback
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.errors import RenderError
from tests.validation.film import camera, diffuse, gray

SMALL = {"chains": 1024, "luminance_samples": 4096, "chains_only": True}


def lit_plane(mono: ModuleType, **parts: Any) -> Any:
    """Return a plane under a point light, with ``parts`` added or replaced (None: left out)."""
    content = {
        "type": "scene",
        "plane": {
            "type": "rectangle", "to_world": mono.ScalarTransform4f().rotate([0, 1, 0], 180),
            "bsdf": diffuse(mono, 0.5),
        },
        "lamp": {"type": "point", "position": [0, 0, -1], "intensity": gray(mono, 1.0)},
        "sensor": camera(mono, [0, 0, -3]),
    } | parts  # fmt: skip
    return mono.load_dict({key: part for key, part in content.items() if part is not None})


def fog(mono: ModuleType) -> dict[str, Any]:
    return {
        "type": "sphere", "bsdf": {"type": "null"},
        "interior": {
            "type": "heterogeneous", "albedo": 0.5,
            "sigma_t": {"type": "constvolume", "value": 1.0},
        },
    }  # fmt: skip


def orthographic(mono: ModuleType) -> dict[str, Any]:
    sensor = camera(mono, [0, 0, -3]) | {"type": "orthographic", "id": "flat"}
    del sensor["fov"]
    return sensor


def plane_of(mono: ModuleType, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "rectangle", "id": "wavy", "bsdf": bsdf}


def bumpy(mono: ModuleType, kind: str) -> dict[str, Any]:
    """Return a surface whose frame a texture turns, inside of another BSDF."""
    flat = mono.Bitmap(np.full((2, 2, 3), 0.5, dtype=np.float32))
    texture = {"type": "bitmap", "raw": True, "bitmap": flat}
    name = {"normalmap": "normalmap", "bumpmap": "texture"}[kind]
    return {
        "type": "twosided",
        "inner": {"type": kind, name: texture, "bsdf": diffuse(mono, 0.5)},
    }  # fmt: skip


def unlit(mono: ModuleType) -> dict[str, Any]:
    return {"type": "point", "position": [0, 0, -1], "intensity": gray(mono, 0.0)}


def shown_by_mitsuba(mono: ModuleType, scene: Any, integrator: Any) -> str:
    """Return what a user of ``mi.render`` sees when it fails."""
    with pytest.raises(RenderError) as caught:
        mono.render(scene, integrator=integrator, spp=1)
    shown = "".join(traceback.format_exception(caught.value))
    assert shown.count("Traceback") == 1
    return shown


CASES: dict[str, tuple[Any, str, str]] = {
    "heterogeneous medium": (lambda mono: {"fog": fog(mono)}, "medium", "use volpath"),
    "heterogeneous medium around the camera": (
        lambda mono: {
            "sensor": camera(mono, [0, 0, -3]) | {"medium": fog(mono)["interior"]}
        }, "medium", "use volpath",
    ),
    "orthographic": (
        lambda mono: {"sensor": orthographic(mono)},
        "sensor", "'flat' is a .*allowed: perspective, thinlens",
    ),
    "normal map": (
        lambda mono: {"plane": plane_of(mono, bumpy(mono, "normalmap"))},
        "bsdf", "shape 'wavy' has a normalmap",
    ),
    "bump map": (
        lambda mono: {"plane": plane_of(mono, bumpy(mono, "bumpmap"))},
        "bsdf", "shape 'wavy' has a bumpmap",
    ),
    "colors of vertices": (
        lambda mono: {
            "plane": plane_of(
                mono,
                {
                    "type": "diffuse",
                    "reflectance": {"type": "mesh_attribute", "name": "vertex_color"},
                },
            )
        }, "bsdf", "shape 'wavy' has a mesh_attribute",
    ),
    "no emitter": (lambda mono: {"lamp": None}, "emitter", "at least one is needed"),
    "projector": (
        lambda mono: {"lamp": {"type": "projector", "id": "beamer", "irradiance": gray(mono, 1.0)}},
        "emitter", "'beamer' is a .*allowed: area, point, spot",
    ),
    "light that is off": (
        lambda mono: {"lamp": unlit(mono)}, "emitter", r"\('lamp'\) emits nothing: raise",
    ),
}  # fmt: skip
DARK: dict[str, tuple[Any, str, str]] = {
    "light behind the plane": (
        lambda mono: {"lamp": unlit(mono) | {"position": [0, 0, 1], "intensity": gray(mono, 1.0)}},
        "luminance_samples", "raise it",
    ),
}  # fmt: skip
ALL = [(kind, name) for name in CASES for kind in ("bdpt", "pssmlt")]
ALL += [("pssmlt", name) for name in DARK]


@pytest.mark.parametrize(("kind", "name"), ALL)
def test_what_cannot_be_rendered_is_told_directly_and_through_mitsuba(
    mono: ModuleType, kind: str, name: str
) -> None:
    parts, field, advice = (CASES | DARK)[name]
    scene = lit_plane(mono, **parts(mono))
    integrator = mono.load_dict({"type": kind} | (SMALL if kind == "pssmlt" else {}))
    with pytest.raises(RenderError, match=advice) as direct:
        integrator.render(scene, spp=1)
    assert direct.value.field == field
    assert re.search(advice, shown_by_mitsuba(mono, scene, integrator))


def test_luminance_samples_too_few_to_see_any_light_are_named_with_their_value(
    mono: ModuleType,
) -> None:
    # A pinhole's view of light that comes through a 2 um gap.
    transform = mono.ScalarTransform4f()
    wall = {
        "type": "rectangle", "to_world": transform.translate([0.501, 0, -0.5]).scale([0.5, 1, 1]),
        "bsdf": {"type": "twosided", "bsdf": diffuse(mono, 0.0)},
    }  # fmt: skip
    other = wall | {"to_world": transform.translate([-0.501, 0, -0.5]).scale([0.5, 1, 1])}
    scene = lit_plane(
        mono, wall=wall, other=other, sensor=camera(mono, [0, 0, -0.4], fov=170, size=8),
        plane={
            "type": "rectangle", "to_world": transform.rotate([0, 1, 0], 180).scale(0.02),
            "bsdf": diffuse(mono, 0.5),
        },
    )  # fmt: skip
    few = mono.load_dict(
        {"type": "pssmlt", "chains": 16, "luminance_samples": 16, "chains_only": True}
    )
    with pytest.raises(RenderError, match=r"luminance_samples = 16: .* raise it"):
        few.render(scene, spp=1)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("luminance_samples", 0), ("p_large", 0.0), ("p_large", 1.5), ("chains", 4),
        ("replicates", 1),
    ],
)  # fmt: skip
def test_a_setting_out_of_range_is_named_with_what_is_allowed(
    mono: ModuleType, field: str, value: float
) -> None:
    integrator = mono.load_dict({"type": "pssmlt", field: value})
    with pytest.raises(RenderError, match=rf"{field} = .*allowed: ") as caught:
        integrator.render(lit_plane(mono), spp=1)
    assert caught.value.field == field
    assert re.search(rf"{field} = .*allowed: ", shown_by_mitsuba(mono, lit_plane(mono), integrator))


@pytest.mark.parametrize(
    ("field", "value"), [("replicates", 1), ("max_depth", 0), ("max_depth", -2), ("rr_depth", -1)]
)
@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
def test_a_setting_of_the_paths_out_of_range_is_named(
    mono: ModuleType, kind: str, field: str, value: int
) -> None:
    with pytest.raises(RenderError, match=rf"{field} = .*allowed: "):
        mono.load_dict({"type": kind, **{field: value}}).render(lit_plane(mono), spp=1)
