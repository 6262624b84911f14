"""A whole sensor as a Mitsuba scene: pad, lit fibers and camera, for any integrator.

The cell sampler does not need it (``render.cells.cell_sampler`` knows fibers and camera by itself).
It is for Mitsuba's own integrators, for ``bdpt`` and ``pssmlt`` as plugins, and for other tools.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.geometry import camera_axes, camera_origin, fiber_poses
from render.optics.pad_scene import pad_shapes, scattering_medium
from render.scene import Profile, Scene

UPRIGHT = 0.999
"""Cosine to the vertical above which a lamp shines straight up or down."""
TABLE_STEPS = 360
"""Steps of theta in which profiles go to Mitsuba as tables."""


def lit_scene(
    scene: Scene,
    phi: Array,
    power: Array,
    bend: float,
    *,
    width: int,
    height: int,
    indented: bool = True,
) -> Any:
    """Return the loaded Mitsuba scene of a lit sensor.

    ``phi`` is ``(fiber,)`` rad; ``power`` ``(fiber,)`` is emitted, and fibers of 0 are left out.
    ``height`` rows of pixels span the camera's vertical field of view.

    Pixel ``(row, column)`` is that of ``render.geometry.camera_rays``; lengths in mm.
    """
    with tempfile.TemporaryDirectory(prefix="tactilux-") as folder:
        content = pad_shapes(scene, bend, indented, Path(folder))
        emitters = {
            int(i): _emitter(lamp.profile, Path(folder) / f"lamp{i}.csv", float(power[i]))
            for i, lamp in enumerate(scene.placed_lamps())
            if power[i] > 0
        }
        content |= fiber_disks(scene, phi, bend, emitters)
        content["camera"] = camera_sensor(scene, width, height, pixel_format="luminance")
        # Unoptimized: the loader would merge equal emitters, and each belongs to one disk.
        return mi.load_dict({"type": "scene", **content}, optimize=False)


def _emitter(profile: Profile, path: Path, power: float) -> dict[str, Any]:
    """Return the emitter of a lamp of ``power``; ``path`` takes what no other emitter knows."""
    if profile.sigma_v is not None:
        return {"type": "fiber", "sigma_v": float(np.degrees(profile.sigma_v)), "power": power}
    theta = np.linspace(0.0, np.pi / 2, TABLE_STEPS + 1)
    np.savetxt(path, np.column_stack([np.degrees(theta), profile.shape(theta)]), delimiter=",")
    return {"type": "measured_light", "filename": str(path), "power": power}


def fiber_disks(
    scene: Scene, phi: Array, bend: float, emitters: dict[int, dict[str, Any]]
) -> dict[str, Any]:
    """Return a black disk for each fiber in ``emitters``, with the emitter that is given for it.

    One in the diffuser refers to the medium of `pad_shapes`.

    ``phi`` is ``(fiber,)`` rad and ``bend`` in rad. Load with ``optimize=False``: Mitsuba would
    merge equal emitters into one.
    """
    poses = fiber_poses(scene, bend)
    beams = poses.directions(phi)
    transform = mi.ScalarTransform4f()
    disks = {}
    medium: dict[str, Any] = {"type": "ref", "id": "diffuser"}
    scatters = scattering_medium(scene) is not None
    for i, emitter in emitters.items():
        center, beam = poses.position[i], beams[i]
        frame = transform.look_at(
            origin=center.tolist(),
            target=(center + beam).tolist(),
            up=(poses.up[i] if abs(beam @ poses.up[i]) < UPRIGHT else poses.along[i]).tolist(),
        )
        disks[f"fiber{i}"] = {
            "type": "disk",
            "to_world": frame.scale(float(poses.radius[i])),
            # What comes back is lost, as with all light that leaves the silicone.
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
            "emitter": emitter,
        }
        if scatters and poses.inside[i] and poses.layer[i] > 0.0:
            disks[f"fiber{i}"] |= {"interior": medium, "exterior": medium}
    return disks


def camera_sensor(scene: Scene, width: int, height: int, **film: Any) -> dict[str, Any]:
    """Return the camera as a ``perspective`` or ``fisheye`` sensor; ``film`` adds to its film.

    Mitsuba 3 has no fisheye; ours is `render.integrators.fisheye`, for ``path`` and ``volpath``.
    """
    origin, (_, down, ahead) = camera_origin(scene), camera_axes(scene)
    angle = float(np.degrees(scene.camera.field_of_view))
    lens: dict[str, Any] = {"type": "perspective", "fov_axis": "y", "fov": angle, "near_clip": 0.01}
    if scene.camera.fisheye:
        lens = {"type": "fisheye", "fov": angle}
    return {
        **lens,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=origin.tolist(), target=(origin + ahead).tolist(), up=(-down).tolist()
        ),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            **film,
        },
    }
