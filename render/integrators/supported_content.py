"""What of a Mitsuba scene the film sampler cannot render, told by name before it starts."""

from __future__ import annotations

import re

import mitsuba as mi

from render.errors import RenderError

SENSORS = {"PerspectiveCamera": "perspective", "ThinLensCamera": "thinlens"}
PERTURBED = {"NormalMap": "normalmap", "BumpMap": "bumpmap"}
"""BSDFs that turn the shading frame: light and camera subpaths then scatter differently."""


def refuse_unsupported(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Raise a RenderError for a variant, sensor, medium, shape or surface not supported."""
    variant = str(mi.variant())
    if not variant.endswith(("_mono", "_rgb")):
        raise RenderError(
            f"variant {variant} is not supported, allowed: mono and rgb variants of llvm and cuda; "
            "use mi.set_variant('llvm_ad_rgb')",
            field="variant",
        )
    kind = sensor.class_name()
    if kind not in SENSORS:
        raise RenderError(
            f"sensor {sensor.id()!r} is a {kind}, which is not supported, allowed: "
            f"{', '.join(SENSORS.values())}; use path or volpath for this scene",
            field="sensor",
        )
    _refuse_heterogeneous(sensor.get_medium())
    for shape in scene.shapes():
        _refuse_heterogeneous(shape.interior_medium())
        _refuse_heterogeneous(shape.exterior_medium())
        if shape.shape_type() == mi.ShapeType.SDFGrid.value:
            raise RenderError(
                f"shape {shape.id()!r} is an sdfgrid, whose normals need not be those of its "
                "surface, which is not supported, allowed: any other shape; make a mesh of it, or "
                "use path",
                field="shape",
            )
        if shape.bsdf() is not None:
            _refuse_surface(shape)


def _refuse_heterogeneous(medium: mi.Medium | None) -> None:
    if medium is not None and not medium.is_homogeneous():
        raise RenderError(
            f"medium {medium.id()!r} is heterogeneous, allowed: homogeneous media; "
            "use volpath for this scene",
            field="medium",
        )


def _refuse_surface(shape: mi.Shape) -> None:
    """Look into nested BSDFs and textures, which Mitsuba shows only by their description."""
    found = re.findall(r"\b(NormalMap|BumpMap|MeshAttribute)\[", str(shape.bsdf()))
    for name in found[:1]:
        if name in PERTURBED:
            raise RenderError(
                f"the BSDF of shape {shape.id()!r} has a {PERTURBED[name]}, which is not "
                "supported, allowed: any other BSDF; bend the mesh instead, or use path",
                field="bsdf",
            )
        raise RenderError(
            f"the BSDF of shape {shape.id()!r} has a mesh_attribute texture, which is not "
            "supported, allowed: textures over uv; use path for this scene",
            field="bsdf",
        )
