"""Mitsuba's gallery: small scenes that hold every plugin of a kind, each before its own pixels.

A *board* is a picture of cells, one plugin each, so that one kernel serves them all. Contents are
those of Mitsuba's documentation and tests, written anew.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import trimesh

from tests.validation.film import diffuse, gray
from tests.validation.rooms import color

Content = dict[str, Any]
CELL = 6
"""Rows and columns of pixels of one cell."""
EYE = 20.0
"""Distance of the camera from a board."""

TRANSPARENT = {
    "dielectric": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "roughdielectric": {"type": "roughdielectric", "alpha": 0.2, "int_ior": 1.5, "ext_ior": 1.0},
    "thindielectric": {"type": "thindielectric"},
    "principled": {"type": "principled", "roughness": 0.3, "spec_trans": 0.8},
    "principledthin": {"type": "principledthin", "roughness": 0.4, "diff_trans": 0.6},
    "mask": {"type": "mask", "opacity": 0.4, "a": {"type": "twosided", "b": {"type": "diffuse"}}},
    "null": {"type": "null"},
}


def bsdfs(mi: ModuleType) -> dict[str, Content]:
    """Return one BSDF of each plugin, some of them with a texture."""
    metal = {"eta": 0.2, "k": 3.9}
    return TRANSPARENT | {
        "diffuse": {"type": "diffuse", "reflectance": color(mi, [0.7, 0.5, 0.2])},
        "conductor": {"type": "conductor", **metal},
        "roughconductor": {"type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.4, **metal},
        "plastic": {"type": "plastic", "nonlinear": True},
        "roughplastic": {"type": "roughplastic", "alpha": 0.15},
        "pplastic": {"type": "pplastic", "alpha": 0.2},
        "twosided": {"type": "twosided", "a": {"type": "diffuse"}, "b": {"type": "plastic"}},
        "blendbsdf": {
            "type": "blendbsdf", "weight": 0.4, "a": {"type": "diffuse"},
            "b": {"type": "roughconductor", "alpha": 0.3, **metal},
        },
    }  # fmt: skip


def textures(mi: ModuleType) -> dict[str, Content]:
    """Return one texture of each plugin."""
    pixels = np.random.default_rng(2).random((4, 8, 1 if "mono" in mi.variant() else 3))
    grid = np.random.default_rng(3).random((2, 2, 2, 1 if "mono" in mi.variant() else 3))
    volume = {
        "type": "gridvolume", "grid": mi.VolumeGrid(grid.astype(np.float32)), "raw": True,
        "to_world": mi.ScalarTransform4f().translate([-8, -8, -8]).scale(16),
    }  # fmt: skip
    return {
        "bitmap": {
            "type": "bitmap", "raw": True, "bitmap": mi.Bitmap(pixels.astype(np.float32)),
            "filter_type": "nearest", "wrap_mode": "mirror",
            "to_uv": mi.ScalarTransform3f().scale([1.5, 1.5]),
        },
        "checkerboard": {"type": "checkerboard", "to_uv": mi.ScalarTransform3f().scale([3, 3])},
        "uniform": {"type": "uniform", "value": 0.6},
        "srgb": {"type": "rgb", "value": [0.6, 0.3, 0.1]},
        "rawconstant": {"type": "rawconstant", "value": 0.3},
        "volume": {"type": "volume", "volume": volume},
    }  # fmt: skip


def phases() -> dict[str, Content]:
    """Return one phase function of each plugin."""
    forward = {"type": "hg", "g": 0.6}
    blend = {"type": "blendphase", "weight": 0.3, "a": forward, "b": {"type": "rayleigh"}}
    return {
        "isotropic": {"type": "isotropic"},
        "hg": forward,
        "rayleigh": {"type": "rayleigh"},
        "tabphase": {"type": "tabphase", "values": "0.5, 1.0, 0.8, 2.0"},
        "blendphase": blend,
    }


def serialize(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh in the format of Mitsuba's ``serialized``, version 4, with face normals."""
    content = struct.pack("<I", 0x1010) + b"ball\0"
    content += struct.pack("<QQ", len(mesh.vertices), len(mesh.faces))
    content += mesh.vertices.astype("<f4").tobytes() + mesh.faces.astype("<u4").tobytes()
    data = struct.pack("<HH", 0x041C, 4) + zlib.compress(content)
    path.write_bytes(data + struct.pack("<QI", 0, 1))


def shapes(mi: ModuleType, folder: Path) -> dict[str, Content]:
    """Return one shape of each plugin about the origin, within 0.4 of it."""
    transform = mi.ScalarTransform4f()
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.38)
    smooth: Any = mesh.export(file_type="ply", vertex_normal=True)
    (folder / "ball.ply").write_bytes(smooth)
    flat: Any = mesh.export(file_type="obj")
    (folder / "ball.obj").write_text(flat)
    np.savetxt(folder / "curve.txt", [(x, 0.3 * x * x, 0.2, 0.12) for x in (-0.5, -0.2, 0.1, 0.4)])
    serialize(folder / "ball.serialized", mesh)
    turned = transform.rotate([1, 1, 0], 40)
    return {
        "rectangle": {"type": "rectangle", "to_world": turned.scale(0.35)},
        "disk": {"type": "disk", "to_world": turned.scale(0.4)},
        "sphere": {"type": "sphere", "radius": 0.4},
        "cylinder": {"type": "cylinder", "p0": [-0.3, 0, 0], "p1": [0.3, 0, 0], "radius": 0.25},
        "cube": {"type": "cube", "to_world": turned.scale(0.25)},
        "ply": {"type": "ply", "filename": str(folder / "ball.ply")},
        "obj": {"type": "obj", "filename": str(folder / "ball.obj"), "face_normals": True},
        "serialized": {"type": "serialized", "filename": str(folder / "ball.serialized")},
        "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        "bsplinecurve": {"type": "bsplinecurve", "filename": str(folder / "curve.txt")},
        "linearcurve": {"type": "linearcurve", "filename": str(folder / "curve.txt")},
    }  # fmt: skip


# -- boards --------------------------------------------------------------------------------------


def places(count: int) -> list[tuple[float, float]]:
    """Return the centers of so many cells on a square board, row by row from the top left."""
    side = int(np.ceil(np.sqrt(count)))
    middle = 0.5 * (side - 1)
    return [(k % side - middle, middle - k // side) for k in range(count)]


def board_camera(mi: ModuleType, count: int) -> Content:
    """Return a camera far from a board of so many cells, with ``CELL`` pixels for each."""
    side = int(np.ceil(np.sqrt(count)))
    return {
        "type": "perspective", "fov": float(2 * np.degrees(np.arctan(0.5 * side / EYE))),
        # Mitsuba's x runs to the left of what looks along +z.
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[0, 0, EYE], target=[0, 0, 0], up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm", "width": CELL * side, "height": CELL * side,
            "rfilter": {"type": "box"},
            "pixel_format": "luminance" if "mono" in mi.variant() else "rgb",
        },
    }  # fmt: skip


def moved(mi: ModuleType, shape: Content, place: tuple[float, float]) -> Content:
    """Return ``shape`` at the center of a cell."""
    move = mi.ScalarTransform4f().translate([*place, 0.0])
    return shape | {"to_world": move @ shape.get("to_world", mi.ScalarTransform4f())}


def board(mi: ModuleType, parts: dict[str, Content], *, light: bool = True) -> Any:
    """Return a loaded board of shapes by their names, before a gray wall, under lamp and sky."""
    transform = mi.ScalarTransform4f()
    content: Content = {
        "type": "scene",
        "sensor": board_camera(mi, len(parts)),
        "wall": {
            "type": "rectangle", "bsdf": diffuse(mi, 0.5),
            "to_world": transform.translate([0, 0, -0.8]).scale(0.5 * len(parts)),
        },
    }  # fmt: skip
    if any(part["type"] == "instance" for part in parts.values()):
        turned = transform.rotate([1, 1, 0], 40).scale(0.25)
        content["group"] = {
            "type": "shapegroup",
            "cube": {"type": "cube", "to_world": turned, "bsdf": {"type": "plastic"}},
        }
    if light:
        content["sky"] = {"type": "constant", "radiance": gray(mi, 0.4)}
        content["lamp"] = {
            "type": "disk",
            "to_world": transform.look_at(origin=[2, 5, 6], target=[0, 0, 0], up=[0, 0, 1]).scale(
                1.5
            ),
            "emitter": {"type": "area", "radiance": gray(mi, 8.0)},
        }
    for place, (name, part) in zip(places(len(parts)), parts.items(), strict=True):
        content[f"cell {name}".replace(".", " ")] = moved(mi, part, place)
    # Unoptimized: merged meshes have no boxes, and Mitsuba's own light from afar is wrong there.
    return mi.load_dict(content, optimize=False)


def cells(images: np.ndarray, count: int) -> np.ndarray:
    """Return means over each cell and all channels, ``(run, cell)``, of a board's pictures."""
    runs, rows, columns, _ = images.shape
    cut = images.mean(axis=-1).reshape(runs, rows // CELL, CELL, columns // CELL, CELL)
    return np.asarray(cut.mean(axis=(2, 4)).reshape(runs, -1)[:, :count])


Board = Callable[[ModuleType, Path], dict[str, Content]]


def surfaces(mi: ModuleType, folder: Path) -> dict[str, Content]:
    """Return balls of all BSDFs, plates of all textures, and all shapes."""
    ball = {"type": "sphere", "radius": 0.4}
    plate = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -20).scale(0.4),
    }
    plain = {"type": "diffuse", "reflectance": gray(mi, 0.6)}
    parts = {f"bsdf {name}": ball | {"bsdf": bsdf} for name, bsdf in bsdfs(mi).items()}
    for name, texture in textures(mi).items():
        parts[f"texture {name}"] = plate | {"bsdf": {"type": "diffuse", "reflectance": texture}}
    for name, shape in shapes(mi, folder).items():
        parts[f"shape {name}"] = shape | ({} if name == "instance" else {"bsdf": plain})
    return parts


def media(mi: ModuleType, _folder: Path) -> dict[str, Content]:
    """Return balls of fog of all phase functions."""
    fog = {"type": "homogeneous", "albedo": color(mi, [0.95, 0.9, 0.7]), "sigma_t": 3.0}
    return {
        f"phase {name}": {
            "type": "sphere", "radius": 0.4, "bsdf": {"type": "null"},
            "interior": fog | {"phase": phase},
        } for name, phase in phases().items()
    }  # fmt: skip


def lamps(mi: ModuleType, folder: Path) -> dict[str, Content]:
    """Return balls under one local lamp of each kind; they light their neighbors a little."""
    table = folder / "led.csv"
    table.write_text("angle,intensity\n0,1\n10,2\n30,1.5\n60,0.3\n80,0\n")
    pixels = np.random.default_rng(4).random((4, 4, 1 if "mono" in mi.variant() else 3))
    texture = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(pixels.astype(np.float32))}
    down = mi.ScalarTransform4f().translate([0, 0, 1.2]).rotate([1, 0, 0], 180)
    disk = {"type": "disk", "to_world": down.scale(0.3)}
    spot = {
        "type": "spot", "to_world": down, "cutoff_angle": 25.0, "beam_width": 10.0,
        "intensity": gray(mi, 4.0),
    }  # fmt: skip
    tube = {"type": "cylinder", "p0": [-0.3, 0, 1], "p1": [0.3, 0, 1], "radius": 0.1}
    return {
        "emitter area": disk
        | {"emitter": {"type": "area", "radiance": {"type": "d65", "scale": 3.0}}},
        "emitter area, textured": {
            "type": "rectangle", "to_world": down.scale(0.3),
            "emitter": {"type": "area", "radiance": texture},
        },
        "emitter area, tube": tube | {"emitter": {"type": "area", "radiance": gray(mi, 1.0)}},
        "emitter point": {
            "type": "point", "to_world": down, "intensity": gray(mi, 0.5), "sampling_weight": 3.0,
        },
        "emitter spot": spot,
        "emitter spot, textured": spot | {"texture": texture},
        "emitter fiber": disk | {"emitter": {"type": "fiber", "sigma_v": 12.0, "power": 1.0}},
        "emitter measured_light": disk
        | {"emitter": {"type": "measured_light", "filename": str(table), "power": 1.0}},
    }  # fmt: skip


# -- pictures ------------------------------------------------------------------------------------

VIEWED = {"near_clip": 3.5, "far_clip": 5.0}
CAMERAS: dict[str, tuple[Content, Content]] = {
    "sensor perspective, all": (
        VIEWED | {
            "fov_axis": "y", "shutter_open": 0.0, "shutter_close": 1.0,
        },
        {
            "crop_width": 12, "crop_height": 10, "crop_offset_x": 2, "crop_offset_y": 4,
            "rfilter": {"type": "gaussian", "stddev": 0.6},
        },
    ),
    "sensor thinlens, all": (
        VIEWED | {"type": "thinlens", "aperture_radius": 0.2, "focus_distance": 4.5},
        {"rfilter": {"type": "tent"}},
    ),
}  # fmt: skip
"""What is added to sensor and film of ``view``; each kernel knows all parameters at once."""
SINGLE_CAMERAS: dict[str, tuple[Content, Content]] = {
    "sensor perspective, near_clip": ({"near_clip": 3.5}, {}),
    "sensor perspective, far_clip": ({"far_clip": 5.0}, {}),
    "sensor thinlens": ({"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 4.0}, {}),
    "film hdrfilm, crop": ({}, {"crop_width": 8, "crop_height": 6, "crop_offset_y": 7}),
    "film hdrfilm, sample_border": ({}, {"sample_border": True}),
    "rfilter box": ({}, {}),
    "rfilter gaussian": ({}, {"rfilter": {"type": "gaussian"}}),
    "rfilter tent": ({}, {"rfilter": {"type": "tent"}}),
}
"""The same one by one."""


def view(
    mi: ModuleType, lens: Content, film: Content, *, optimize: bool = False, **parts: Any
) -> Any:
    """Return a floor with a ball and two cubes under a lamp, seen by a camera 4 mm away."""
    transform = mi.ScalarTransform4f()
    content: Content = {
        "type": "scene",
        "sensor": {
            "type": "perspective", "fov": 40,
            "to_world": transform.look_at(origin=[0, -4, 1.5], target=[0, 0, 0.2], up=[0, 0, 1]),
            "film": {
                "type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"},
                "pixel_format": "luminance" if "mono" in mi.variant() else "rgb",
            } | film,
        } | lens,
        "floor": {"type": "rectangle", "to_world": transform.scale(3), "bsdf": diffuse(mi, 0.5)},
        "ball": {
            "type": "sphere", "center": [-0.5, 0, 0.5], "radius": 0.5,
            "bsdf": {"type": "roughplastic", "alpha": 0.2},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": transform.translate([0.5, -1, 3]).rotate([1, 0, 0], 180).scale(0.8),
            "emitter": {"type": "area", "radiance": color(mi, [6.0, 5.0, 4.0])},
        },
    }  # fmt: skip
    # Light in every block, beyond the far plane too, with a spread to test against.
    pixels = np.random.default_rng(5).random((64, 128, 3)).astype(np.float32)
    content["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "scale": 0.4}
    for name, x, y in (("near cube", 0.6, -0.6), ("far cube", 0.8, 1.2)):
        to_world = transform.translate([x, y, 0.3]).scale(0.3)
        content[name] = {"type": "cube", "to_world": to_world, "bsdf": diffuse(mi, 0.7)}
    return mi.load_dict(content | parts, optimize=optimize)


FORMATS: dict[str, Content] = {
    "luminance": {"pixel_format": "luminance"},
    "xyz": {"pixel_format": "xyz", "component_format": "float32"},
    "pfm": {"file_format": "pfm", "component_format": "float32"},
    "rgb": {"pixel_format": "rgb"},
    "uint32": {"component_format": "uint32"},
    "rgbe": {"file_format": "rgbe", "component_format": "float32"},
}
"""Films that hold one picture in several ways."""
