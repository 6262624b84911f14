"""The Mitsuba scene of a sensor: meshes, dielectric faces, scattering layer and coating.

Only what the scene declares is built: no diffuser, no medium; index 1, no dielectric. The body is
black and never modeled: light that leaves the silicone is lost (thesis 3.3).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import trimesh

from render.geometry.meshes import pad_meshes
from render.scene import Scene


def outer_face(scene: Scene) -> dict[str, Any]:
    """Return the BSDF of the faces between silicone and air.

    Beckmann with separable Smith shadowing, as in Mitsuba; roughness 0 is a smooth dielectric and
    index 1 no boundary at all.
    """
    pad = scene.pad
    if pad.index == 1.0:
        return {"type": "null"}
    if pad.roughness == 0.0:
        return {"type": "dielectric", "int_ior": pad.index, "ext_ior": 1.0}
    return {
        "type": "roughdielectric",
        "distribution": "beckmann",
        "alpha": pad.roughness,
        "int_ior": pad.index,
        "ext_ior": 1.0,
    }


def scattering_medium(scene: Scene) -> dict[str, Any] | None:
    """Return the homogeneous Henyey-Greenstein medium of the diffuser, or None without one."""
    layer = scene.diffuser
    if layer is None or layer.sigma_s + layer.sigma_a == 0.0:
        return None
    extinction = layer.sigma_s + layer.sigma_a
    return {
        "type": "homogeneous",
        "sigma_t": extinction,
        "albedo": layer.sigma_s / extinction,
        "phase": {"type": "hg", "g": layer.g},
    }


def pad_shapes(scene: Scene, bend: float, indented: bool, folder: Path) -> dict[str, Any]:
    """Return the shapes of the pad as a Mitsuba scene dictionary; writes meshes into ``folder``."""
    meshes = pad_meshes(scene, bend, indented)
    medium = scattering_medium(scene)
    content: dict[str, Any] = {}
    if medium:
        content["diffuser"] = {**medium, "id": "diffuser"}
    inside = {"interior": {"type": "ref", "id": "diffuser"}} if medium else {}
    face = outer_face(scene)
    coating = {
        "type": "diffuse",
        "reflectance": {"type": "rgb", "value": scene.coating.albedo}
        if "rgb" in str(mi.variant())
        else {"type": "uniform", "value": scene.coating.albedo},
    }
    content["coating"] = _shape(meshes.coating, folder / "coating.ply", coating)
    content["outer_clear"] = _shape(meshes.outer_clear, folder / "outer_clear.ply", face)
    if meshes.outer_diffuser is not None:
        path = folder / "outer_diffuser.ply"
        content["outer_diffuser"] = {**_shape(meshes.outer_diffuser, path, face), **inside}
    if meshes.interface is not None and medium:
        path = folder / "interface.ply"
        content["interface"] = {**_shape(meshes.interface, path, {"type": "null"}), **inside}
    return content


def pad_scene(scene: Scene, bend: float, indented: bool) -> Any:
    """Return the loaded Mitsuba scene of the unlit pad at ``bend`` radians."""
    with tempfile.TemporaryDirectory(prefix="tactilux-") as name:
        shapes = pad_shapes(scene, bend, indented, Path(name))
        return mi.load_dict({"type": "scene", **shapes})


def _shape(mesh: trimesh.Trimesh, path: Path, bsdf: dict[str, Any]) -> dict[str, Any]:
    content: Any = mesh.export(file_type="ply", vertex_normal=False)
    path.write_bytes(content)
    return {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf}
