"""What of Mitsuba's gallery ``bdpt`` and ``pssmlt`` refuse, as scenes, and what the rest is."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from tests.validation.gallery import Content, view

Case = tuple[Callable[[ModuleType], tuple[Any, Content]], str]
"""What makes a scene and an integrator, and what the sentence has to say."""

REFERENCES = {
    ("integrator", name) for name in ("path", "volpath", "volpathmis", "ptracer", "direct", "depth")
}
"""Mitsuba's own integrators, in which nothing is nested."""
NOT_OBJECTS = {("shape", "merge"), ("texture", "d65")}
"""Plugins that become others when a scene is loaded: meshes, and spectra that boards have."""
UNREACHED = {
    ("bsdf", "measured"): "needs a measurement's file",
    ("bsdf", "measured_polarized"): "for polarized variants, which are refused",
    ("film", "specfilm"): "for spectral variants, which are refused",
    ("integrator", "stokes"): "for polarized variants, which are refused",
    ("shape", "blender"): "for Blender's own memory",
}
"""Plugins that cannot be loaded here, and why; none of their classes is on the list."""


def refused() -> dict[str, Case]:
    """Return the cases by ``kind plugin[, variation]``."""
    return {**_surfaces(), **_lights(), **_volumes(), **_cameras(), **_options()}


def _with(**parts: Any) -> Callable[[ModuleType], tuple[Any, Content]]:
    """Return what makes the view with ``parts``, values or functions of Mitsuba, for ``bdpt``."""

    def make(mi: ModuleType) -> tuple[Any, Content]:
        made = {name: part(mi) if callable(part) else part for name, part in parts.items()}
        lens, film = made.pop("lens", {}), made.pop("film", {})
        return view(mi, lens, film, **made), {"type": "bdpt"}

    return make


def _floor(bsdf: Any) -> Callable[[ModuleType], tuple[Any, Content]]:
    return _with(
        floor=lambda mi: {"type": "rectangle", "bsdf": bsdf(mi) if callable(bsdf) else bsdf}
    )


def _surfaces() -> dict[str, Case]:
    plain: Content = {"type": "diffuse"}
    checker: Content = {"type": "checkerboard"}
    turned = {"type": "twosided", "a": {"type": "bumpmap", "b": plain, "c": checker}}
    half = {"type": "blendbsdf", "weight": 0.5, "a": {"type": "polarizer"}, "b": plain}
    regular = {"type": "regular", "values": "1, 2", "wavelength_min": 400, "wavelength_max": 700}
    irregular = {"type": "irregular", "values": "1, 2", "wavelengths": "400, 700"}
    colors = {"type": "mesh_attribute", "name": "vertex_color"}

    def distances(mi: ModuleType) -> Content:
        grid = np.linspace(-1.0, 1.0, 64, dtype=np.float32).reshape(4, 4, 4, 1)
        return {"type": "sdfgrid", "grid": mi.TensorXf(grid)}

    def ellipsoids(kind: str) -> Callable[[ModuleType], Content]:
        def make(mi: ModuleType) -> Content:
            one = {
                "centers": np.zeros((1, 3)), "scales": np.ones((1, 3)),
                "quaternions": np.array([[0, 0, 0, 1.0]]),
            }  # fmt: skip
            return {"type": kind, **{k: mi.TensorXf(x.astype(np.float32)) for k, x in one.items()}}

        return make

    return {
        "bsdf polarizer": (_floor({"type": "polarizer"}), "has a polarizer"),
        "bsdf polarizer, in a blend": (_floor(half), "has a polarizer"),
        "bsdf circular": (_floor({"type": "circular"}), "has a circular"),
        "bsdf retarder": (_floor({"type": "retarder"}), "has a retarder"),
        "bsdf hair": (_floor({"type": "hair"}), "has a Hair"),
        "bsdf bumpmap": (_floor(turned), "has a bumpmap"),
        "bsdf normalmap": (
            _floor({"type": "normalmap", "normalmap": checker | {}, "b": plain}), "has a normalmap"
        ),
        "bsdf null, of a lamp": (
            _with(
                ball={
                    "type": "sphere", "bsdf": {"type": "null"},
                    "emitter": {"type": "area", "radiance": 1.0},
                }
            ),
            "emits light and has a null BSDF",
        ),
        "texture mesh_attribute": (
            _floor(plain | {"reflectance": colors}), "has a mesh_attribute"
        ),
        "texture blackbody": (
            _with(
                sky={"type": "constant", "radiance": {"type": "blackbody", "temperature": 3000}}
            ),
            "has a BlackBodySpectrum",
        ),
        "texture regular": (
            _with(sky={"type": "constant", "radiance": regular}), "has a RegularSpectrum"
        ),
        "texture irregular": (
            _with(sky={"type": "constant", "radiance": irregular}), "has a IrregularSpectrum"
        ),
        "shape sdfgrid": (_with(ball=distances), "is an sdfgrid"),
        "shape ellipsoids": (_with(ball=ellipsoids("ellipsoids")), "is a Ellipsoids"),
        "shape ellipsoidsmesh": (_with(ball=ellipsoids("ellipsoidsmesh")), "is a EllipsoidsMesh"),
    }  # fmt: skip


def _lights() -> dict[str, Case]:
    light = {"type": "directionalarea", "radiance": 1.0}
    unused = {"type": "point", "intensity": 1.0, "sampling_weight": 0.0}
    return {
        "emitter projector": (_with(beam={"type": "projector"}), "is a Projector"),
        "emitter directionalarea": (
            _with(beam={"type": "disk", "emitter": light}), "is a DirectionalArea"
        ),
        "emitter sunsky": (_with(sky={"type": "sunsky"}), "is a Sunsky"),
        "emitter timed_sunsky": (_with(sky={"type": "timed_sunsky"}), "is a TimedSunsky"),
        "emitter point, sampling_weight 0": (_with(beam=unused), "sampling_weight = 0"),
        "emitter point, in undeclared fog": (
            _with(
                fog={
                    "type": "sphere", "radius": 0.5, "bsdf": {"type": "null"},
                    "center": [0, 0, 1.5], "interior": {"type": "homogeneous"},
                },
                beam={"type": "point", "position": [0, 0, 1.5]},
            ),
            "emitter 'beam' is in another medium",
        ),
    }  # fmt: skip


def _grid(mi: ModuleType, channels: int) -> Content:
    values = np.full((2, 2, 2, channels), 0.5, dtype=np.float32)
    return {"type": "gridvolume", "grid": mi.VolumeGrid(values)}


def _fog(**parts: Any) -> Callable[[ModuleType], tuple[Any, Content]]:
    def ball(mi: ModuleType) -> Content:
        inside = {name: part(mi) if callable(part) else part for name, part in parts.items()}
        medium = {"type": "homogeneous"} | inside
        return {"type": "sphere", "radius": 0.5, "bsdf": {"type": "null"}, "interior": medium}

    return _with(ball=ball)


def _volumes() -> dict[str, Case]:
    def flakes(mi: ModuleType) -> Content:
        return {"type": "sggx", "S": _grid(mi, 6)}

    def some_flakes(mi: ModuleType) -> Content:
        return {"type": "blendphase", "weight": 0.5, "a": {"type": "hg"}, "b": flakes(mi)}

    return {
        "phase sggx": (_fog(phase=flakes), "has an sggx"),
        "phase sggx, in a blend": (_fog(phase=some_flakes), "has an sggx"),
        "medium heterogeneous": (
            _fog(type="heterogeneous", albedo=0.5, sigma_t=1.0), "has a heterogeneous"
        ),
        "medium homogeneous, of changing albedo": (
            _fog(albedo=lambda mi: _grid(mi, 3)), "has a GridVolume as albedo"
        ),
        "medium homogeneous, undeclared around the camera": (
            _with(
                fog={
                    "type": "sphere", "radius": 20.0, "bsdf": {"type": "null"},
                    "interior": {"type": "homogeneous"},
                }
            ),
            "sensor 'sensor' is in another medium",
        ),
    }  # fmt: skip


def _cameras() -> dict[str, Case]:
    films = {
        "film hdrfilm, luminance_alpha": ({"pixel_format": "luminance_alpha"}, "with alpha"),
        "film hdrfilm, rgba": ({"pixel_format": "rgba"}, "with alpha"),
        "film hdrfilm, xyza": ({"pixel_format": "xyza"}, "with alpha"),
        "film hdrfilm, sample_border of a gaussian": (
            {"sample_border": True, "rfilter": {"type": "gaussian"}}, "sample_border = True"
        ),
        "rfilter lanczos": ({"rfilter": {"type": "lanczos"}}, "has a LanczosSincFilter"),
        "rfilter mitchell": ({"rfilter": {"type": "mitchell"}}, "has a MitchellNetravaliFilter"),
        "rfilter catmullrom": ({"rfilter": {"type": "catmullrom"}}, "has a CatmullRomFilter"),
    }  # fmt: skip
    dot = {"film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}}
    meter = {"type": "rectangle", "meter": {"type": "irradiancemeter"} | dot}

    def sensor(kind: str, **parts: Any) -> Any:
        return _with(sensor={"type": kind} | dot | parts)

    return {name: (_with(film=film), named) for name, (film, named) in films.items()} | {
        "sensor perspective, principal point": (
            _with(lens={"principal_point_offset_y": 0.1}), "no light from where its own rays"
        ),
        "sensor thinlens, focus behind the far plane": (
            _with(
                lens={
                    "type": "thinlens", "aperture_radius": 0.1, "focus_distance": 8.0,
                    "far_clip": 6.0,
                }
            ),
            "no light from where its own rays",
        ),
        "sensor orthographic": (sensor("orthographic"), "is a OrthographicCamera"),
        "sensor distant": (sensor("distant"), "is a DistantSensor"),
        "sensor radiancemeter": (sensor("radiancemeter"), "is a RadianceMeter"),
        "sensor batch": (
            sensor("batch", inner={"type": "perspective"} | dot), "is a BatchSensor"
        ),
        "sensor irradiancemeter": (_with(sensor=meter), "is a IrradianceMeter"),
    }  # fmt: skip


def _options() -> dict[str, Case]:
    def by(**integrator: Any) -> Callable[[ModuleType], tuple[Any, Content]]:
        return lambda mi: (view(mi, {}, {}), {"type": "bdpt"} | integrator)

    ours = {"type": "bdpt"}
    return {
        "integrator aov": (by(type="aov", aovs="d:depth", a=ours), "inside of another integrator"),
        "integrator moment": (by(type="moment", a=ours), "inside of another integrator"),
        "integrator bdpt, hide_emitters": (by(hide_emitters=True), "hide_emitters = True"),
        "integrator bdpt, samples_per_pass": (by(samples_per_pass=4), "samples_per_pass = 4"),
        "integrator bdpt, timeout": (by(timeout=3.0), "timeout = 3"),
        "integrator bdpt, block_size": (by(block_size=16), "block_size = 16"),
        "integrator bdpt, max_depth of a float": (by(max_depth=3.5), "of type float"),
        "integrator pssmlt, unknown": (by(type="pssmlt", mutations=3), "mutations = 3"),
    }
