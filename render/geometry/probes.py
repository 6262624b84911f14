"""What can be pressed into the pad, by name: ball, bolt, edge, pyramids, or a mesh file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from render.errors import SceneError
from render.geometry.height_map import SMOOTHING, HeightMap, map_lines
from render.geometry.indenter import (
    BoltHead,
    Imprint,
    ball,
    bolt,
    pyramids,
    skin_heights,
    smoothed_skin,
    straight_edge,
)
from render.mesh_units import Unit
from render.refused_values import did_you_mean
from render.scene import Scene

PROBES = ("none", "pyramids", "ball", "bolt", "edge")
BALL_RADIUS, PROBE_DEPTH = 3.0, 1.0
"""Radius of the ball, and how deep ball, bolt and edge are pressed in unless it is told, mm."""


def probe(
    scene: Scene,
    press: str,
    depth: float | None = None,
    smoothing: float | None = None,
    unit: Unit | None = None,
) -> Imprint | HeightMap | None:
    """Return what is pressed in; None for nothing and for the pyramids as they are.

    Arguments:
        scene: the sensor.
        press: one of PROBES, or the path of a mesh file.
        depth: how deep its lowest point is pressed in, mm; None is its own default.
        smoothing: length of `HeightMap.smoothed`, mm; None is SMOOTHING for a file, which has sharp
            edges and upright walls, and none for the others, whose walls are draped.
        unit: of the file; None finds it.

    Raises:
        SceneError: no such probe, an option that it does not have, or a pad too small for it.
    """
    if unit is not None and press in PROBES:
        raise SceneError(
            f"unit = {unit} with press = {press}, allowed: with a mesh file", field="unit"
        )
    if press in ("none", "pyramids"):
        if depth is not None:
            raise SceneError(
                f"depth = {depth:g} with press = {press}, allowed: with ball, bolt, edge or a mesh "
                "file; indenter.radius and indenter.slope of the scene say how deep pyramids are",
                field="depth",
            )
        if press == "none" or not smoothing:
            return None
        return smoothed_skin(scene, pyramids(scene), smoothing)
    if press not in PROBES:
        if not Path(press).is_file():
            raise SceneError(
                f"press = {press!r} is no file, allowed: {', '.join(PROBES)} or a mesh file"
                f"{did_you_mean(press, PROBES)}",
                field="press",
            )
        # Only a file needs numba and trimesh.
        from render.geometry.mesh_probe import body_of_file

        smooth = SMOOTHING if smoothing is None else smoothing
        return body_of_file(scene, Path(press), depth, smooth, unit)
    deep = PROBE_DEPTH if depth is None else depth
    if press == "ball":
        if deep >= BALL_RADIUS:
            raise SceneError(
                f"depth = {deep:g} mm of the ball, allowed: less than its radius, {BALL_RADIUS:g} "
                "mm",
                field="depth",
            )
        body = ball(scene, BALL_RADIUS, deep)
        return _round_skin(scene, body, deep, smoothing) if smoothing else body
    body = bolt(scene, BoltHead(depth=deep)) if press == "bolt" else straight_edge(scene, deep)
    return smoothed_skin(scene, body, smoothing) if smoothing else body


def _round_skin(scene: Scene, body: Imprint, depth: float, smoothing: float) -> HeightMap:
    """Return the skin over the ball itself, of which ``body`` has planes."""
    x, y = map_lines(scene)
    # Heights over the body's center on the skin.
    above = (BALL_RADIUS - depth) * body.turn[0][:, 2]
    away = np.hypot(
        x[None, :] - body.center[0, 0] - above[0], y[:, None] - body.center[0, 1] - above[1]
    )
    untouched = skin_heights(scene, x, y) - body.center[0, 2]
    height = untouched + np.sqrt(np.maximum(BALL_RADIUS**2 - away**2, 0.0)) - above[2]
    height = np.where(away < BALL_RADIUS, height, 0.0)
    skin = HeightMap(np.maximum(height, 0.0), scene.pad.width, scene.pad.length)
    return skin.smoothed(smoothing)
