"""The window under a pad in the preview: one of the pad's own index is more of the pad."""

from __future__ import annotations

from typing import Any, NamedTuple

from render.scene import Scene, unchecked


class Bond(NamedTuple):
    """Where a window of another index meets the pad: ``height`` mm over its lower face; its index.

    Arguments:
        height: the window's thickness.
        window_index: its refractive index.
    """

    height: float
    window_index: float


def bond_of(scene: Scene) -> Bond | None:
    """Return where light bends between pad and window, or None where it does not."""
    if scene.window is None or not scene.window_refracts:
        return None
    return Bond(scene.window.thickness, scene.window.index)


def with_bonded_window(scene: Scene) -> Scene:
    """Return the scene with its window as the lower part of the pad, moved up onto z = 0.

    One without a window is returned as it is. Where the window's index is another (`bond_of`), the
    places are right, and the index is the pad's.
    """
    if scene.window is None:
        return scene
    depth = scene.window.thickness

    def lifted(place: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return None if place is None else (*place[:2], place[2] + depth)

    camera, pad = scene.camera, scene.pad
    changes: dict[str, Any] = {
        "window": None,
        "pad": unchecked(pad, {"thickness": pad.thickness + depth}),
        "camera": unchecked(
            camera,
            {
                "distance": None if camera.distance is None else camera.distance - depth,
                "position": lifted(camera.position),
                "look_at": lifted(camera.look_at),
            },
        ),
    }
    if scene.fibers is not None:
        changes["fibers"] = unchecked(scene.fibers, {"height": scene.fibers.height + depth})
    if scene.rows is not None:
        changes["rows"] = tuple(
            unchecked(row, {"height": row.height + depth}) for row in scene.rows
        )
    if scene.lamps is not None:
        changes["lamps"] = tuple(
            unchecked(lamp, {"position": lifted(lamp.position)}) for lamp in scene.lamps
        )
    return unchecked(scene, changes)
