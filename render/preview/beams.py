"""Beams of bare lamps, or what a thin diffuser lets pass unscattered, as point lights.

A lamp in the air shines into the pad through every face that it lies before: the shader refracts
its light there (Snell's law at the plane of the face) and asks whether it enters within the face.
Clear and metal walls send light back: each image of the pad that its light reaches is one more
light. Painted faces let none in. A lamp in the silicone shines from where it is. Where a window of
another index lies under the pad, the light that enters the edges of either is a light of its own.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import FiberPoses, flat_fiber_poses
from render.preview.bonded import Bond
from render.preview.diffuser.cache import slab_of
from render.preview.diffuser.response import diffuse_albedo
from render.preview.light_paths import Turns, reaches, single_turns, wall_images
from render.scene import FACES, OUTWARD, Profile, Scene

BEAM_MARK, TURN_MARKS, NO_TURNS = 8, (16, 256), 8
"""Parts of a light's mark: beside the number of its face, that it is a beam, and how often its
light is reflected at walls along x and y (`WallImage.turns`), each counted from `NO_TURNS`."""
WINDOW_MARK = 4096
"""Part of the mark of a beam that enters the edge of a window of another index than the pad's."""
EMBEDDED_MARK = 8192
"""Part of the mark of a beam that begins in the silicone."""
STEEPEST_ENTRY = 6.0
"""Light that enters an edge from so many times higher or lower than it comes from afar is faint."""
MOST_TURNS, TURNS_AHEAD = 7, 2
"""Reflections that are followed: at walls beside a beam, which are total where the index is above
sqrt(2), and at those that it flies at, which leave a tenth or less."""
STEEPEST = 5.0
"""Tangent of the critical angle at most, which has none at index 1."""
PROFILE_STEPS = 1025
"""Texels of a profile over [0, pi/2]."""


class Beams:
    """Lamps before the pad: seven points of each end, and one for each image of the pad."""

    nodes = None

    units = None

    def __init__(
        self, scene: Scene, bond: Bond | None = None, *, through_layers: bool = True
    ) -> None:
        """Place the lamps' images behind the faces that they shine through.

        With a ``bond`` the shader refracts twice, and lamps are where they are. ``through_layers``
        is whether a diffuser lets some of it pass.
        """
        self._poses = poses = flat_fiber_poses(scene)
        profiles = [lamp.profile for lamp in scene.placed_lamps()]
        self._peak = np.array([profile.peak_intensity for profile in profiles])
        self._own = profile_texels(profiles)
        milky = np.where(poses.inside, poses.milky, 0.0) if through_layers else np.zeros(1)
        if milky.any():
            # The optical depth before a lamp in the diffuser, as far as it is straight ahead.
            depths = [slab_of(scene).optical_depth(length) for length in milky]
            self._own = profile_texels(profiles, depths)
        self.profiles = profile_table(profiles)
        self.defines = {
            "BEAM": "1",
            "EMISSION_TEXELS": "1" if self._own is None else "2",
            "SOFT_RADIUS": f"{poses.radius.min():.6f}",
        }
        if self._own is not None:
            self.defines["PROFILES"] = "1"
        # A diffuser sends back what lamps in the pad shine at it from inside.
        self.edge_albedo = 0.0
        if poses.inside.any():
            self.defines["EMBEDDED"] = "1"
            if scene.diffuser is not None:
                self.edge_albedo = diffuse_albedo(slab_of(scene))
        clear = np.array([finish.paint is None for finish in scene.finishes])
        if not through_layers:
            clear &= ~scene.box.layered
        lists = [_lights_of(scene, poses, i, clear, bond) for i in range(len(profiles))]
        longest = max(map(len, lists))
        # Beyond the end of a list: lights without power.
        dark = [[*position, float(face + BEAM_MARK + np.dot((NO_TURNS, NO_TURNS), TURN_MARKS)), 0.0]
                for position, face in zip(poses.position, poses.face, strict=True)]  # fmt: skip
        self.position = np.array(
            [
                [*part, *[none] * (longest - len(part))]
                for part, none in zip(lists, dark, strict=True)
            ]
        )
        self._weight = self.position[..., 4]
        self.position = self.position[..., :4]

    def emission(self, phi: Array) -> Array:
        """Return beam direction in the face's frame and peak intensity, ``(..., fiber, light, n)``.

        With profiles of several kinds, four more numbers say which.
        """
        poses, shape = self._poses, (*phi.shape, self.position.shape[1])
        beam = poses.directions(phi)
        face = (self.position[..., 3].astype(int)) % BEAM_MARK
        # Each light has the frame of its own face.
        frames = np.stack(face_frames(), axis=1)[face]  # (fiber, light, axis, 3)
        local = np.einsum("flax,...fx->...fla", frames, beam)
        peak = np.broadcast_to(self._weight * self._peak[:, None], shape)
        parts = [local, peak[..., None]]
        if self._own is not None:
            parts.append(np.broadcast_to(self._own[:, None], (*shape, 4)))
        return np.concatenate(parts, axis=-1)

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return all lights of all lamps."""
        one = self.emission(phi)
        emission = np.broadcast_to(one, (3, *one.shape)).copy()
        emission[..., 3] *= power.T[..., None]
        shines = self._weight.ravel() > 0.0
        emission = emission.reshape(3, -1, one.shape[-1])
        return self.position.reshape(1, -1, 4)[:, shines], emission[:, shines]

    def unit_amounts(self, _phi: Array, _power: Array) -> Array:
        """Return none."""
        return np.zeros((3, 0))

    def not_in_units(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return all."""
        return self.merged(phi, power)


def comes_straight(mark: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which lights are not seen in walls, of their marks."""
    turns = NO_TURNS * sum(TURN_MARKS)
    return np.asarray(((mark & BEAM_MARK) == 0) | ((mark % WINDOW_MARK & ~0xF) == turns))


def face_frames() -> tuple[Array, Array, Array]:
    """Return the axes of all `FACES`, each ``(face, 3)``: along, into the pad, up."""
    along = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    up = np.tile([0.0, 0.0, 1.0], (len(FACES), 1))
    up[FACES.index("lower")] = [0.0, 1.0, 0.0]
    return np.array(along), -OUTWARD, up


def _lights_of(
    scene: Scene, poses: FiberPoses, lamp: int, clear: NDArray[np.bool_], bond: Bond | None
) -> list[list[float]]:
    """Return x, y, z, mark and share of the power of each light of one lamp.

    ``clear`` ``(face,)`` are the faces that light comes through.
    """
    box, lights, lower = scene.box, [], FACES.index("lower")
    index = scene.pad.index if bond is None else 1.0

    def seen(point: Array, face: int, turns: Turns, share: float) -> list[list[float]]:
        # From inside the pad the air looks longer by the index (paraxial image).
        distance = box.distance(point)[face]
        image = point + (index - 1) * distance * OUTWARD[face]
        mark = float(face + BEAM_MARK + np.dot(np.add(turns, NO_TURNS), TURN_MARKS))
        if bond is None or face == lower:
            return [[*image, mark, share]]
        above, far = point[2] - bond.height, STEEPEST_ENTRY * distance
        marks = (mark, above > -far), (mark + WINDOW_MARK, above < far)
        return [[*image, each, share] for each, enters in marks if enters]

    if poses.inside[lamp]:
        return _lights_within(scene, poses, lamp, through_layers=bool(clear[box.layered].any()))
    for point, share in zip(*end_points(poses, lamp), strict=True):
        for face in np.flatnonzero((box.distance(point) > 0.0) & clear):
            lights += seen(point, int(face), (0, 0), share)
    center = poses.position[lamp]
    for face in np.flatnonzero((box.distance(center) > 0.0) & clear):
        for turns in beam_turns(scene, int(face)):
            lights += seen(center, int(face), turns, 1.0)
    return lights


def _lights_within(
    scene: Scene, poses: FiberPoses, lamp: int, *, through_layers: bool
) -> list[list[float]]:
    """Return what `_lights_of` does for a lamp in the silicone: straight, and seen in walls."""
    milky = poses.layer[lamp] > 0.0
    if milky and not through_layers:
        return []

    def mark(turns: Turns) -> float:
        turned = np.dot(np.add(turns, NO_TURNS), TURN_MARKS)
        return float(poses.face[lamp] + BEAM_MARK + turned + EMBEDDED_MARK)

    lights = [
        [*point, mark((0, 0)), share] for point, share in zip(*end_points(poses, lamp), strict=True)
    ]
    images = [] if milky else wall_images(scene)
    return lights + [[*poses.position[lamp], mark(image.turns), 1.0] for image in images]


def shines_past_layers(scene: Scene) -> NDArray[np.bool_]:
    """Return ``(lamp,)`` whether some of a lamp lies before a clear face: light without a glow.

    So is that of a lamp in the clear pad.
    """
    poses, box = flat_fiber_poses(scene), scene.box
    clear = ~box.layered & [finish.paint is None for finish in scene.finishes]
    return np.array(
        [
            (poses.inside[lamp] and poses.layer[lamp] == 0.0)
            or any((box.distance(point)[clear] > 0.0).any() for point in end_points(poses, lamp)[0])
            for lamp in range(len(poses.face))
        ]
    )


def beam_turns(scene: Scene, face: int) -> list[Turns]:
    """Return the ``turns`` of the images that light entering through ``face`` may reach.

    It starts away from that face, within the critical angle of its normal.
    """
    axis = int(np.abs(OUTWARD[face]).argmax())
    single = single_turns(scene)
    if single is not None:
        own = tuple(OUTWARD[face][:2].astype(int))
        return [turns for turns in single if turns != own]
    size = scene.box.high - scene.box.low
    # Tangent of the critical angle: how far to the side light gets on its way.
    slope = 1 / np.sqrt(max(scene.pad.index**2 - 1, STEEPEST**-2))
    ahead = 0 if axis == 2 else TURNS_AHEAD
    found = []
    for along in range(ahead + 1):
        way = (along + 1) * size[axis] * slope
        beside = [min(MOST_TURNS, int(np.ceil(way / size[k]))) for k in (0, 1) if k != axis]
        for across in itertools.product(*(range(-count, count + 1) for count in beside)):
            turns = list(across)
            if axis < 2:
                turns.insert(axis, along * int(-OUTWARD[face][axis]))
            if any(turns) and reaches(scene, (turns[0], turns[1])):
                found.append((turns[0], turns[1]))
    return found


def end_points(poses: FiberPoses, lamp: int) -> tuple[Array, Array]:
    """Return points ``(7, 3)`` of a lamp's end and their shares of its power.

    Rabinowitz and Richter's rule of degree 5 on the disk: its center and a hexagon. One that turns
    is taken to stand parallel to its face.
    """
    azimuth = np.pi / 3 * np.arange(6)
    ring = np.sqrt(2 / 3) * poses.radius[lamp]
    along = np.concatenate([[0.0], ring * np.cos(azimuth)])
    up = np.concatenate([[0.0], ring * np.sin(azimuth)])
    first, second = poses.face_along[lamp], poses.face_up[lamp]
    if not poses.turns[lamp]:
        beam = poses.directions(np.full(len(poses.tilt), np.pi / 2))[lamp]
        first = np.cross(second, beam)
        if np.linalg.norm(first) < 1e-6:
            first = poses.face_along[lamp]
        first = first / np.linalg.norm(first)
        second = np.cross(beam, first)
    points = poses.position[lamp] + along[:, None] * first + up[:, None] * second
    return points, np.array([0.25] + [0.125] * 6)


def profile_texels(profiles: list[Profile], depths: list[float] | None = None) -> Array | None:
    """Return kind and parameter of each lamp's profile ``(lamp, 4)``; None: one Gaussian for all.

    The optical ``depths`` of diffuser before lamps in it, if any is, make each its own.

    Kind 0 is a Gaussian with 1 / (2 sigma_v), 1 a power of the cosine, 2 a row of `profile_table`.
    """
    if (
        depths is None
        and len({profile.sigma_v for profile in profiles}) == 1
        and profiles[0].sigma_v is not None
    ):
        return None
    rows, texels = 0, np.zeros((len(profiles), 4))
    texels[:, 2] = depths or 0.0
    for i, profile in enumerate(profiles):
        if profile.sigma_v is not None:
            texels[i, :2] = 0.0, 1 / (2 * profile.sigma_v)
        elif profile.cosine_exponent is not None:
            texels[i, :2] = 1.0, profile.cosine_exponent
        else:
            texels[i, :2] = 2.0, rows
            rows += 1
    return texels


def profile_table(profiles: list[Profile]) -> Array | None:
    """Return the shapes of measured profiles ``(row, step)`` over [0, pi/2], or None."""
    theta = np.linspace(0.0, np.pi / 2, PROFILE_STEPS)
    rows = [profile.shape(theta) for profile in profiles if profile.measured is not None]
    return np.array(rows) if rows else None
