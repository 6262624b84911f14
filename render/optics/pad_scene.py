"""The Mitsuba scene of a sensor: meshes, dielectric faces, scattering layer and coating.

Only what the scene declares is built: no diffuser, no medium; index 1, no dielectric. The body is
black and never modeled: light that leaves the silicone is lost (thesis 3.3).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import trimesh
from numpy.typing import NDArray

from render.geometry.meshes import PadMeshes, mesh_part, pad_meshes, turned_inside_out
from render.scene import Coating, Finish, Scene


def gray(value: float) -> dict[str, Any]:
    """Return a reflectance that is the same in all channels."""
    return {"type": "rgb" if "rgb" in str(mi.variant()) else "uniform", "value": value}


def outer_face(finish: Finish, index: float) -> dict[str, Any]:
    """Return the BSDF of a face between silicone of refractive ``index`` and air, or its paint.

    Beckmann with separable Smith shadowing, as in Mitsuba; roughness 0 is a smooth dielectric and
    index 1 no boundary at all. Paint and metal are seen by the side that normals point to.
    """
    if finish.paint is not None:
        reflectance = gray(finish.paint.reflectance)
        if finish.paint.mirror:
            # A perfect mirror, which sends back this part of the light.
            return {"type": "conductor", "material": "none", "specular_reflectance": reflectance}
        return {"type": "diffuse", "reflectance": reflectance}
    if index == 1.0:
        return {"type": "null"}
    if finish.roughness == 0.0:
        return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    return {
        "type": "roughdielectric",
        "distribution": "beckmann",
        "alpha": finish.roughness,
        "int_ior": index,
        "ext_ior": 1.0,
    }


def coated(coating: Coating) -> dict[str, Any]:
    """Return the BSDF of the skin from inside.

    Lambertian, and with a lobe a mixture of that and microfacets of a mirror (Walter et al. 2007):
    ``f = albedo / pi + specular D G / (4 cos cos)``. Both parts are blended as bright as the whole,
    so that the blend's weight is the chance with which the lobe is sampled.
    """
    if coating.lobe is None:
        return {"type": "diffuse", "reflectance": gray(coating.single_albedo)}
    specular, roughness = coating.lobe
    whole = gray(coating.reflectance)
    mirror = {"type": "roughconductor", "material": "none", "distribution": "beckmann"}
    return {
        "type": "blendbsdf",
        "weight": specular / coating.reflectance,
        "lambertian": {"type": "diffuse", "reflectance": whole},
        "lobe": {**mirror, "alpha": roughness, "specular_reflectance": whole},
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
    content["coating"] = _shape(meshes.coating, folder / "coating.ply", coated(scene.coating))
    for name, finish, mesh in _outer_parts(scene, "outer_clear", meshes):
        path = folder / f"{name}.ply"
        content[name] = _shape(mesh, path, outer_face(finish, scene.pad.index))
    for name, finish, mesh in _outer_parts(scene, "outer_diffuser", meshes):
        path = folder / f"{name}.ply"
        behind = {"exterior": inside["interior"]} if inside and finish.paint else inside
        content[name] = {**_shape(mesh, path, outer_face(finish, scene.pad.index)), **behind}
    if scene.window is not None and meshes.window is not None:
        window, window_index = meshes.window, scene.window.index
        for name, finish, mesh in _alike(scene, "window", window.outer, window.side):
            content[name] = _shape(mesh, folder / f"{name}.ply", outer_face(finish, window_index))
        if window_index != scene.pad.index:
            smooth = {"type": "dielectric", "int_ior": scene.pad.index, "ext_ior": window_index}
            content["bond"] = _shape(window.bond, folder / "bond.ply", smooth)
    if meshes.interface is not None and medium:
        path = folder / "interface.ply"
        content["interface"] = {**_shape(meshes.interface, path, {"type": "null"}), **inside}
    return content


def _outer_parts(
    scene: Scene, name: str, meshes: PadMeshes
) -> Iterator[tuple[str, Finish, trimesh.Trimesh]]:
    """Yield the faces to the air of clear pad or diffuser: those alike together, with a name.

    Normals of painted ones point into the silicone, as the coating's do.
    """
    clear = name == "outer_clear"
    mesh = meshes.outer_clear if clear else meshes.outer_diffuser
    if mesh is not None:
        side = meshes.clear_side if clear else meshes.diffuser_side
        yield from _alike(scene, name, mesh, side)


def _alike(
    scene: Scene, name: str, mesh: trimesh.Trimesh, side: NDArray[np.int64]
) -> Iterator[tuple[str, Finish, trimesh.Trimesh]]:
    """Yield the parts of a mesh on whose faces ``side`` ``(triangle,)`` the same lies."""
    # The far side of the diffuser is no face that a scene can name.
    of_face = [*scene.finishes, Finish(scene.pad.roughness)]
    kinds = list(dict.fromkeys([of_face[-1], *of_face]))
    kind = np.array([kinds.index(finish) for finish in of_face])
    of_triangle = kind[side]
    for number in np.unique(of_triangle):
        part = mesh if len(kinds) == 1 else mesh_part(mesh, of_triangle == number)
        if kinds[number].paint is not None:
            part = turned_inside_out(part)
        yield name if number == 0 else f"{name}_{number}", kinds[number], part


def pad_scene(scene: Scene, bend: float, indented: bool) -> Any:
    """Return the loaded Mitsuba scene of the unlit pad at ``bend`` radians."""
    with tempfile.TemporaryDirectory(prefix="tactilux-") as name:
        shapes = pad_shapes(scene, bend, indented, Path(name))
        loaded = mi.load_dict({"type": "scene", **shapes})
    # Of all plugins (Mitsuba 3.9) the phase function alone has its number compiled into kernels, so
    # that a diffuser of another g would have its own.
    parameters = mi.traverse(loaded)
    for key, value in list(parameters):
        if key.endswith("phase_function.g"):
            number = mi.Float(value)
            dr.make_opaque(number)
            parameters[key] = number
    parameters.update()
    return loaded


def _shape(mesh: trimesh.Trimesh, path: Path, bsdf: dict[str, Any]) -> dict[str, Any]:
    content: Any = mesh.export(file_type="ply", vertex_normal=False)
    path.write_bytes(content)
    return {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf}
