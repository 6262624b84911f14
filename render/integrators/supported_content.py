"""The gate for Mitsuba scenes: all that is rendered is on a positive list, or refused by name.

Objects say by ``traverse`` and in their descriptions what they have. A plugin or a parameter that
is not in ``render.integrators.supported_plugins``, of a later Mitsuba say, is refused before
anything is rendered, and so is a value on which ours and Mitsuba's integrators would differ.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from render.errors import RenderError
from render.integrators.supported_plugins import PLUGINS, REFUSED

VARIANTS = ("llvm_ad_mono", "llvm_ad_rgb", "cuda_ad_mono", "cuda_ad_rgb")
_BASES = {
    "sensor": "Sensor", "film": "Film", "rfilter": "ReconstructionFilter", "sampler": "Sampler",
    "emitter": "Emitter", "shape": "Shape", "bsdf": "BSDF", "medium": "Medium",
    "phase": "PhaseFunction", "texture": "Texture", "volume": "Volume",
}  # fmt: skip
"""Kinds of plugins, and Mitsuba's classes of which they are."""


def refuse_unsupported(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Raise a RenderError that names the first thing of a scene that is not supported.

    Looked at is what a picture by ``sensor`` shows: other sensors and integrators are not.
    """
    refuse_variant()
    check_names(scene, "scene", {"allow_thread_reordering", *_children(scene), "children"})
    shapes = list(scene.shapes())
    shapes += [part for part in _children(scene).values() if class_of(part) == "ShapeGroupPlugin"]
    for part in (sensor, *shapes, *scene.emitters()):
        for kind, inner, owner in _contents(part, ""):
            _refuse_plugin(kind, inner, owner)
            _refuse_values(inner, owner)
    _refuse_lens(sensor)


def refuse_variant() -> None:
    """Raise a RenderError for a variant of Mitsuba other than the four that are supported."""
    if (variant := str(mi.variant())) not in VARIANTS:
        raise RenderError(
            f"variant {variant} is not supported, allowed: {', '.join(VARIANTS)}; "
            "use mi.set_variant('llvm_ad_rgb')",
            field="variant",
        )


def refuse_gradients(parameters: Any) -> None:
    """Raise a RenderError where gradients are asked for of ``parameters``, a mapping of them."""
    for name in list(parameters.keys()):
        try:
            enabled = dr.grad_enabled(parameters[name])
        except TypeError:  # Mitsuba 3.9 lists parameters of hair that were not given
            continue
        if enabled:
            raise RenderError(
                f"{name} has gradients enabled, which bdpt and pssmlt do not compute, allowed: "
                "none; use prb or prbvolpath, or dr.disable_grad",
                field="params",
            )


def check_names(part: mi.Object, subject: str, allowed: set[str]) -> None:
    """Raise a RenderError for a parameter that ``part`` shows and that is not ``allowed``."""
    if unknown := sorted(_shown_names(part) - allowed):
        raise RenderError(
            f"{subject} has the parameter {unknown[0]!r}, which is not known here, allowed: "
            f"{', '.join(sorted(allowed)) or 'none'}; use path or volpath for this scene",
            field=unknown[0],
        )


# -- what a scene holds --------------------------------------------------------------------------


def _traversed(part: mi.Object) -> tuple[set[str], dict[str, Any]]:
    """Return the names of the values of one object, and its parts by theirs."""
    values: set[str] = set()
    parts: dict[str, Any] = {}
    part.traverse(_callback_class()(values, parts))
    return values, parts


@functools.cache
def _callback_class() -> type:
    """Return what takes those: its base exists only once a variant is set."""

    class Callback(mi.TraversalCallback):
        def __init__(self, values: set[str], parts: dict[str, Any]) -> None:
            mi.TraversalCallback.__init__(self)
            self.values, self.parts = values, parts

        def put(self, name: str, value: Any, _flags: Any, _type: Any = None) -> None:
            if isinstance(value, mi.Object):
                self.parts[name] = value
            else:
                self.values.add(name)

    return Callback


def _children(part: mi.Object) -> dict[str, Any]:
    """Return what belongs to ``part``; filters of films are not among what Mitsuba traverses."""
    _, children = _traversed(part)
    return children | ({"filter": part.rfilter()} if isinstance(part, mi.Film) else {})


def _shown_names(part: mi.Object) -> set[str]:
    """Return the names of all parameters, by traversal and by the description."""
    text, (values, parts) = str(part).rstrip(), _traversed(part)
    # Some descriptions hold those of their parts as they are; long ones may hold short ones.
    for child in sorted(map(str, _children(part).values()), key=len, reverse=True):
        text = text.replace(child, "")
    pattern = r"^(?:  (\w+)(?:\[\d+\])? = |(\w+): )" if "\n" in text else r"[\[,] ?(\w+)()="
    described = {name or other for name, other in re.findall(pattern, text, re.MULTILINE)}
    return described | values | set(parts)


def _contents(part: mi.Object, owner: str) -> Iterator[tuple[str, mi.Object, str]]:
    """Yield the kinds of ``part`` and all in it, with what they belong to ("" at the top)."""
    kind = next((k for k, base in _BASES.items() if isinstance(part, getattr(mi, base))), "")
    yield kind, part, owner
    for child in _children(part).values():
        # Shapes belong to a group, and emitters to a shape, but are things of their own.
        apart = isinstance(child, mi.Shape | mi.Emitter)
        yield from _contents(child, "" if apart else owner or f"{kind} {part.id()!r}")


def class_of(part: mi.Object) -> str:
    """Return the class; those written in Python all share their base's name in Mitsuba."""
    name = type(part).__name__
    name = str(part.class_name()) if hasattr(mi, name) else name
    return name.split("[")[0]


# -- what is refused -----------------------------------------------------------------------------


def _refuse_plugin(kind: str, part: mi.Object, owner: str) -> None:
    """Raise a RenderError unless class and parameters of ``part`` are on the list."""
    known = dict(PLUGINS.get(kind, {}).values())
    name = class_of(part)
    if name not in known:
        plugin, step = REFUSED.get(name, (name, "use path or volpath"))
        article = "an" if plugin.startswith(("sdf", "sgg")) else "a"
        subject = f"{owner} has" if owner else f"{kind} {part.id()!r} is"
        raise RenderError(
            f"{subject} {article} {plugin}, which is not supported as {kind}, allowed: "
            f"{', '.join(PLUGINS.get(kind, {})) or 'none'}; {step} for this scene",
            field=_field(kind, owner),
        )
    allowed = set(known[name].split())
    if isinstance(part, mi.Mesh):
        # Only a mesh_attribute texture would ask for these, and that is not on the list.
        allowed |= {n for n in _shown_names(part) if n.startswith(("vertex_", "face_"))}
    if name == "ShapeGroupPlugin":
        allowed |= set(_children(part))
    check_names(part, f"{kind} {part.id()!r}", allowed)


def _field(kind: str, owner: str) -> str:
    """Return what an error is about: a texture is part of a BSDF, or of what it belongs to."""
    if kind not in ("texture", "volume"):
        return kind
    return "bsdf" if owner.startswith("shape") else owner.partition(" ")[0]


def _refuse_values(part: mi.Object, owner: str) -> None:
    """Raise a RenderError for a value with which Mitsuba's integrators would render otherwise."""
    if isinstance(part, mi.Film):
        if mi.has_flag(part.flags(), mi.FilmFlags.Alpha):
            raise RenderError(
                f"the film of {owner} has a pixel_format with alpha, allowed: luminance, rgb, xyz; "
                "use one of these",
                field="pixel_format",
            )
        if part.sample_border() and not part.rfilter().is_box_filter():
            raise RenderError(
                f"the film of {owner} has sample_border = True, allowed: False, or a box filter",
                field="sample_border",
            )
    if isinstance(part, mi.Medium):
        for name, child in _children(part).items():
            if isinstance(child, mi.Volume) and class_of(child) != "ConstVolume":
                raise RenderError(
                    f"medium {part.id()!r} has a {class_of(child)} as {name}, allowed: "
                    "constvolume; use volpath for this scene",
                    field="medium",
                )
    if isinstance(part, mi.Emitter) and (weight := _number(part, "sampling_weight", 1.0)) <= 0:
        raise RenderError(
            f"emitter {part.id()!r} has sampling_weight = {weight:g}, allowed: above 0; leave the "
            "emitter out, or use path",
            field="sampling_weight",
        )
    if isinstance(part, mi.Shape) and part.emitter() is not None and part.bsdf() is not None:
        flags = part.bsdf().flags()
        scatters = (mi.BSDFFlags.Smooth, mi.BSDFFlags.DeltaReflection)
        # Light subpaths start on such a surface, but camera subpaths pass it.
        if mi.has_flag(flags, mi.BSDFFlags.Null) and not any(
            mi.has_flag(flags, other) for other in scatters
        ):
            raise RenderError(
                f"shape {part.id()!r} emits light and has a null BSDF, allowed: any other; give it "
                "a black diffuse BSDF",
                field="bsdf",
            )


def _refuse_lens(sensor: mi.Sensor) -> None:
    """Raise a RenderError for a camera that would not take light where its own rays look.

    Mitsuba's cameras do so, and ``ptracer`` lacks that light, with a principal point that is
    shifted, and with a focus that is not between the clipping planes.
    """
    near, far = sensor.near_clip(), sensor.far_clip()
    shifts = [_number(sensor, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    if any(shifts) or not near <= _number(sensor, "focus_distance", near) <= far:
        raise RenderError(
            f"sensor {sensor.id()!r} takes no light from where its own rays look, allowed: "
            "principal_point_offset_x and _y of 0, focus_distance between near_clip and far_clip; "
            "crop a larger film, or use path",
            field="sensor",
        )


def _number(part: mi.Object, name: str, default: float) -> float:
    """Return a parameter; ``default`` where ``part`` does not show it."""
    parameters = mi.traverse(part)
    return float(dr.slice(parameters[name])) if name in parameters else default
