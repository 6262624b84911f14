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
from render.geometry import camera_origin, fiber_poses
from render.optics.pad_scene import pad_shapes
from render.scene import Scene


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

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad.
        power: ``(fiber,)`` emitted power of each fiber; those of 0 are left out.
        bend: rad.
        width: pixels per row of the sensor's film.
        height: rows, which span the camera's vertical field of view.
        indented: pressed by the pyramids, or untouched.

    Pixel ``(row, column)`` is that of ``render.geometry.visibility``; lengths in mm.
    """
    with tempfile.TemporaryDirectory(prefix="tactilux-") as folder:
        content = pad_shapes(scene, bend, indented, Path(folder))
        sigma_v = float(np.degrees(scene.fibers.sigma_v))
        content |= fiber_disks(
            scene,
            phi,
            bend,
            {
                int(i): {"type": "fiber", "sigma_v": sigma_v, "power": float(power[i])}
                for i in np.nonzero(power > 0)[0]
            },
        )
        content["camera"] = pinhole(scene, width, height, pixel_format="luminance")
        # Unoptimized: the loader would merge equal emitters, and each belongs to one disk.
        return mi.load_dict({"type": "scene", **content}, optimize=False)


def fiber_disks(
    scene: Scene, phi: Array, bend: float, emitters: dict[int, dict[str, Any]]
) -> dict[str, Any]:
    """Return a black disk for each fiber in ``emitters``, with the emitter that is given for it.

    ``phi`` is ``(fiber,)`` rad and ``bend`` in rad. Load with ``optimize=False``: Mitsuba would
    merge equal emitters into one.
    """
    poses = fiber_poses(scene, bend)
    beams = poses.directions(phi, scene.fibers.tilt)
    transform = mi.ScalarTransform4f()
    disks = {}
    for i, emitter in emitters.items():
        center, beam = poses.position[i], beams[i]
        frame = transform.look_at(
            origin=center.tolist(), target=(center + beam).tolist(), up=poses.up[i].tolist()
        )
        disks[f"fiber{i}"] = {
            "type": "disk",
            "to_world": frame.scale(scene.fibers.diameter / 2),
            # What comes back is lost, as with all light that leaves the silicone.
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
            "emitter": emitter,
        }
    return disks


def pinhole(scene: Scene, width: int, height: int, **film: Any) -> dict[str, Any]:
    """Return the camera as a ``perspective`` sensor; ``film`` adds to its film's parameters."""
    origin = camera_origin(scene)
    ahead = (origin + [0.0, 0.0, 1.0]).tolist()
    return {
        "type": "perspective",
        "fov_axis": "y",
        "fov": float(np.degrees(scene.camera.field_of_view)),
        "near_clip": 0.01,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=origin.tolist(), target=ahead, up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            **film,
        },
    }
