"""A window of the pad's own index is more of the pad: level 0 draws both as one."""

from __future__ import annotations

from typing import Any

from render.errors import RenderError
from render.scene import Scene


def drawable(scene: Scene) -> Scene:
    """Return the scene that level 0 can draw: with a window of the pad's index.

    Where the window's index is another, its light is no more than a first guess, which renders
    correct: of lamps at the window's edges it can be off by a factor of two.
    """
    if scene.window is None or not scene.window_refracts:
        return scene
    window = scene.window.model_copy(update={"index": scene.pad.index})
    return scene.model_copy(update={"window": window})


def with_bonded_window(scene: Scene) -> Scene:
    """Return the scene with its window as the lower part of the pad, moved up onto z = 0.

    One without a window is returned as it is.

    Raises:
        RenderError: the indices of pad and window differ.
    """
    if scene.window is None:
        return scene
    depth = scene.window.thickness
    if scene.window_refracts:
        raise RenderError(
            f"window.index = {scene.window.index:g}: the preview knows no refraction between a pad "
            "and a window of other index, "
            f"allowed for it: pad.index = {scene.pad.index:g}; level 2 knows it, "
            "render with --level reference",
            field="window.index",
        )

    def lifted(place: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return None if place is None else (*place[:2], place[2] + depth)

    camera, pad = scene.camera, scene.pad
    changes: dict[str, Any] = {
        "window": None,
        "pad": pad.model_copy(update={"thickness": pad.thickness + depth}),
        "camera": camera.model_copy(
            update={
                "distance": None if camera.distance is None else camera.distance - depth,
                "position": lifted(camera.position),
                "look_at": lifted(camera.look_at),
            }
        ),
    }
    if scene.fibers is not None:
        changes["fibers"] = scene.fibers.model_copy(update={"height": scene.fibers.height + depth})
    if scene.rows is not None:
        changes["rows"] = tuple(
            row.model_copy(update={"height": row.height + depth}) for row in scene.rows
        )
    if scene.lamps is not None:
        changes["lamps"] = tuple(
            lamp.model_copy(update={"position": lifted(lamp.position)}) for lamp in scene.lamps
        )
    return scene.model_copy(update=changes)
