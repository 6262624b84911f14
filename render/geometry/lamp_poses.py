"""Where lamps are and where they shine, at any bend: fiber ends in rows, and listed lamps.

They are numbered as in ``render.scene.lamps`` and carried by the body when the pad bends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.bending import bend_frames, bend_points
from render.scene import FACES, OUTWARD, PlacedLamp, Scene

LOWER = FACES.index("lower")


@dataclass(frozen=True)
class FiberPoses:
    """Lamps in the world frame; arrays ``(fiber, 3)`` or ``(fiber,)`` float64, mm and rad.

    ``along`` is phi = 0 (towards the tip on the sides, towards +x at the tip), ``inward`` is
    phi = pi/2 (normal to the edge), ``up`` points to the coating; ``tilt`` lifts the beam towards
    it. Lamps that do not turn (``turns``) shine as at pi/2 whatever phi is. ``radius`` is that of
    their ends.

    The frame of the face that each one shines through: ``foot``, its point nearest to the lamp,
    ``face_along``, ``face_inward`` (its normal, into the pad) and ``face_up``; ``face`` is its
    number in `render.scene.FACES`, ``gap`` the distance to it, below 0 where a lamp is cast into
    the silicone, and ``layer`` the thickness of diffuser that is behind it or around the lamp.
    """

    position: Array
    along: Array
    inward: Array
    up: Array
    tilt: Array
    turns: NDArray[np.bool_]
    radius: Array
    face: NDArray[np.int64]
    gap: Array
    layer: Array
    foot: Array
    face_along: Array
    face_inward: Array
    face_up: Array

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Return which lamps are cast into the silicone, ``(fiber,)``."""
        return self.gap < 0.0

    @property
    def milky(self) -> Array:
        """Return the diffuser before each lamp (mm): all of it, or what a lamp in it has before."""
        return self.layer + np.where(self.layer > 0.0, np.minimum(self.gap, 0.0), 0.0)

    def directions(self, phi: Array) -> Array:
        """Return unit beam directions ``(..., fiber, 3)`` for ``phi`` ``(..., fiber)`` radians."""
        turned = np.where(self.turns, phi, np.pi / 2)
        cos, sin = np.cos(turned)[..., None], np.sin(turned)[..., None]
        in_plane = cos * self.along + sin * self.inward
        tilt = self.tilt[:, None]
        return np.asarray(np.cos(tilt) * in_plane + np.sin(tilt) * self.up)


def fiber_edges(scene: Scene) -> list[str]:
    """Return the edge whose row each lamp is of, or ``listed``."""
    return [lamp.edge or "listed" for lamp in scene.placed_lamps()]


def flat_fiber_poses(scene: Scene) -> FiberPoses:
    """Return the lamps on the flat pad."""
    lamps, box = scene.placed_lamps(), scene.box
    gap, foot = np.zeros(len(lamps)), np.zeros((len(lamps), 3))
    for i, lamp in enumerate(lamps):
        gap[i] = box.distance(lamp.position)[lamp.face]
        foot[i] = lamp.position - gap[i] * OUTWARD[lamp.face]
    face = np.array([lamp.face for lamp in lamps])
    rim = np.array([*box.rims, 0.0])
    clear = np.array([lamp.solid in ("pad", "window") for lamp in lamps])
    up = np.tile([0.0, 0.0, 1.0], (len(lamps), 1))
    return FiberPoses(
        position=np.array([lamp.position for lamp in lamps]),
        along=np.array([lamp.along for lamp in lamps]),
        inward=np.array([lamp.inward for lamp in lamps]),
        up=up,
        tilt=np.array([lamp.tilt for lamp in lamps]),
        turns=np.array([lamp.turns for lamp in lamps]),
        radius=np.array([lamp.diameter / 2 for lamp in lamps]),
        face=face,
        gap=gap,
        layer=np.where(clear, 0.0, rim[face]),
        foot=foot,
        face_along=np.where(np.isin(face, (0, 2))[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),
        face_inward=-OUTWARD[face],
        face_up=np.where((face == LOWER)[:, None], [0.0, 1.0, 0.0], up),
    )


def fiber_poses(scene: Scene, bend: float) -> FiberPoses:
    """Return the lamps in the world at ``bend`` radians; states of a skin leave them alone."""
    flat = flat_fiber_poses(scene)
    if scene.states is not None:
        return flat
    turn = bend_frames(scene, flat.position[:, 1], bend)
    names = ("along", "inward", "up", "face_along", "face_inward", "face_up")
    turned = {name: np.einsum("fij,fj->fi", turn, getattr(flat, name)) for name in names}
    position = bend_points(scene, flat.position, bend)
    foot = position + flat.gap[:, None] * turned["face_inward"]
    return replace(flat, position=position, foot=foot, **turned)


@dataclass(frozen=True)
class MirrorTwins:
    """What a sensor that is its own mirror image in the plane x = 0 makes of its lamps.

    ``twin`` ``(fiber,)`` is the mirror image of each; where ``flips``, phi runs the other way.
    """

    twin: NDArray[np.int64]
    flips: NDArray[np.bool_]


def mirror_twins(scene: Scene) -> MirrorTwins | None:
    """Return the mirror images of the lamps, or None where one, or a side of the pad, has none."""
    left, _, right, _ = scene.box.rims
    if scene.finish("left") != scene.finish("right") or left != right:
        return None
    poses, lamps = flat_fiber_poses(scene), scene.placed_lamps()
    sign = np.array([-1.0, 1.0, 1.0])
    beam = poses.directions(np.full(len(lamps), np.pi / 2))
    pose = np.concatenate([poses.position, beam], axis=1)
    near = np.abs(pose[None] - (pose.reshape(-1, 2, 3) * sign).reshape(-1, 1, 6)).max(axis=-1)
    alike = np.array([[_same_end(a, b) for b in lamps] for a in lamps])
    match = (near < 1e-9) & alike
    if not (match.sum(axis=1) == 1).all():
        return None
    twin = match.argmax(axis=1)
    flips = (poses.along * sign * poses.along[twin]).sum(axis=1) < 0
    return MirrorTwins(twin, flips & poses.turns)


def _same_end(a: PlacedLamp, b: PlacedLamp) -> bool:
    return (a.diameter, a.profile, a.turns) == (b.diameter, b.profile, b.turns)
