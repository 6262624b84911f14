"""Skins whose albedo depends on the camera's channel: a copy of every lamp for each albedo.

What a channel sees of such a sensor is what it sees of the sensor with that channel's albedo all
over. So transport with an axis of channels is transport without one from more lamps: each lamp has
one copy per albedo, which shines into the channels of that albedo alone. Everything that superposes
light and learns it is then as for any other sensor. Copies lie albedo by albedo,
``copy = albedo * lamps + lamp``; with one albedo they are the lamps themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from render.arrays import Array
from render.geometry import FiberPoses, flat_fiber_poses
from render.scene import Scene


def copied(scene: Scene, values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return ``values`` of lamps along ``axis`` as those of their copies."""
    count = len(scene.albedos)
    return values if count == 1 else np.concatenate([values] * count, axis=axis)


def copied_poses(scene: Scene) -> FiberPoses:
    """Return where the copies stand on the flat pad: where their lamps do."""
    poses = flat_fiber_poses(scene)
    return replace(poses, **{name: copied(scene, value) for name, value in vars(poses).items()})


def split_channels(scene: Scene, values: Array) -> Array:
    """Return ``(copy, ...)`` of what is known by channel, ``(lamp, ..., channel)``.

    Where the albedo is one, ``values`` have no axis of channels and stay as they are.
    """
    if not scene.by_channel:
        return values
    seen_in = [scene.albedo_of_channel.index(albedo) for albedo in range(len(scene.albedos))]
    return np.concatenate([values[..., channel] for channel in seen_in])


def joined_channels(scene: Scene, values: Array) -> Array:
    """Return ``(lamp, ..., channel)`` of what is known of copies; undoes `split_channels`."""
    if not scene.by_channel:
        return values
    by_albedo = values.reshape(len(scene.albedos), scene.lamp_count, *values.shape[1:])
    return np.stack([by_albedo[albedo] for albedo in scene.albedo_of_channel], axis=-1)


def channel_mask(scene: Scene) -> Array:
    """Return ``(albedo, channel)``: 1 where the channel sees that albedo, else 0."""
    every = np.arange(len(scene.albedos))[:, None]
    return np.asarray(every == np.array(scene.albedo_of_channel), dtype=np.float64)


def split_power(scene: Scene, power: Array) -> Array:
    """Return ``(..., copy, channel)`` of what lamps give to channels, ``(..., lamp, channel)``."""
    if not scene.by_channel:
        return power
    return np.concatenate([power * seen for seen in channel_mask(scene)], axis=-2)
