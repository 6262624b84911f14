"""What the page knows: 16-bit tables of light, and the sensor, its limits and touches as JSON."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from optimize.design import Array, SearchLimits, exclusive_groups, limits_of
from optimize.readers import CameraModel, PlaceError, SensorError
from optimize.readers.camera_model import FULL_SCALE
from optimize.readers.polynomials import derivatives
from optimize.readers.sensor_reader import COLOR_DEGREE, LEAST_DEVIATION, RIDGE
from render.errors import SceneError
from render.geometry import (
    SHADOW_LENGTH,
    Imprint,
    ball,
    bolt,
    camera_axes,
    camera_origin,
    counted_sites,
    declared_sites,
    facet_normals,
    fiber_edges,
    flat_fiber_poses,
    flat_sites,
    half_view,
    in_state,
    pyramids,
    straight_edge,
)
from render.geometry.holder import LEAST_SINE
from render.preview.bonded import bond_of, with_bonded_window
from render.preview.skin_texels import skin_surface
from render.scene import Palette, Scene, unchecked

LEVELS = 65535
"""Steps of a 16-bit table: the largest value has this number."""
TOUCH_DEPTH = 1.0
"""mm that touches are pressed in, or a quarter of the pad."""
SURFACE_STEPS = 65
"""Places along x and y at which the page knows a skin that is not flat."""
BEAM = 5.0, 0.22
"""Length of a drawn beam: at most so many mm, and at most so much of the pad's width."""


def packed(tables: Mapping[str, Array]) -> tuple[str, dict[str, dict[str, float]]]:
    """Return non-negative tables as one base64 text of 16-bit integers, and where each one is.

    A table has one ``step``: value = integer * step, so its error is at most half a step, 8e-6 of
    its largest value. float64 in, ``first`` and ``count`` in integers.
    """
    parts, places, first = [], {}, 0
    for name, table in tables.items():
        step = float(table.max()) / LEVELS or 1.0
        parts.append(np.round(np.clip(table, 0.0, None) / step).astype("<u2").ravel())
        places[name] = {"first": first, "count": table.size, "step": step}
        first += table.size
    return base64.b64encode(np.concatenate(parts).tobytes()).decode("ascii"), places


def sensor_facts(scene: Scene) -> dict[str, Any]:
    """Return where everything is, in mm and rad: what the page draws and what its limits are.

    Named states share all of it but ``skins``, one for each, and none of them is bent.
    """
    bond, counted, axis = bond_of(scene), counted_sites(scene), _axis(scene)
    sensors = [in_state(scene, state) for state in scene.state_axis]
    skins = [with_bonded_window(one) for one, _ in sensors]
    scene = skins[0]
    poses = flat_fiber_poses(scene)
    fibers = [
        {
            "edge": edge if edge == "listed" else f"{edge} edge",
            "turns": bool(turns),
            **{axis: float(at[i]) for i, axis in enumerate("xy")},
            "along": along[:2].tolist(),
            "inward": inward[:2].tolist(),
        }
        for edge, turns, at, along, inward in zip(
            fiber_edges(scene), poses.turns, poses.position, poses.along, poses.inward, strict=True
        )
    ]
    pad, camera, sites = scene.pad, scene.camera, scene.sites
    right, down, ahead = camera_axes(scene)
    return {
        "fibers": fibers,
        "beam": min(BEAM[0], BEAM[1] * pad.width),
        "pad": {
            "width": pad.width,
            "length": pad.length,
            "index": pad.index,
            "rims": list(scene.box.rims),
            "bond": bond._asdict() if bond else None,
        },
        "sites": flat_sites(scene)[:, :2].tolist(),
        "grid": {
            "columns": sites.columns,
            "rows": sites.rows,
            "spacing": sites.spacing,
            "first": declared_sites(scene)[0, :2].tolist(),
            "counted": counted.tolist(),
        },
        "normals": facet_normals(scene).tolist(),
        "camera": {
            "columns": camera.columns,
            "rows": camera.rows,
            "albedo": max(one.coating.reflectance for one in scene.one_albedo_scenes),
            "fisheye": camera.fisheye,
            "half_view": list(half_view(scene, camera.columns, camera.rows)),
            "place": camera_origin(scene).tolist(),
            "axes": [(-right).tolist(), (-down).tolist(), ahead.tolist()],
            "pivot": camera.pivot,
        },
        "axis": axis,
        "bends": [bend for _, bend in sensors],
        "limits": _limits(limits_of(scene)),
        "touches": list(_touches(scene)),
        "shadow": SHADOW_LENGTH,
        "skins": [_skin(one) for one in (skins if axis["word"] == "state" else skins[:1])],
    }


def _axis(scene: Scene) -> dict[str, Any]:
    """Return what the axis of states has, see `Scene.state_word`, and its values for people."""
    titles = scene.state_titles
    if scene.state_word == "bend":
        titles = tuple(f"{round(math.degrees(angle))}°" for angle in scene.state_axis)
    return {"word": scene.state_word, "titles": list(titles)}


def _skin(scene: Scene) -> dict[str, Any]:
    """Return the height of the skin's crown, mm, and its surface where it is not flat.

    That is normals into the pad and heights (mm) on an even grid.
    """
    surface = None
    if scene.skin is not None:
        texels = skin_surface(scene, SURFACE_STEPS)
        surface = {"steps": SURFACE_STEPS, "texels": texels.round(5).ravel().tolist()}
    return {"thickness": scene.pad.thickness, "surface": surface}


def reader_facts(scene: Scene, camera: CameraModel) -> dict[str, Any]:
    """Return what both readers know, as `SensorError` and `PlaceError` lay it out: no light.

    Lists are flat. ``plane`` are parts (normal, 2) of normals along x and y, ``weights`` (normal,
    facet + 1) make their colors, ``steepness`` (2, normal, facet + 1) their derivatives by the
    parts; ``apart`` are the degrees between normals that are another answer, else 0. Normals of the
    sensor reader are (bend, site, normal). An entry of ``monomials`` is a variable, the numbers of
    a lower monomial and of that one times the variable, and the variable's power there.
    """
    sensor, place = SensorError(scene, camera), PlaceError(scene, camera)
    lowered = derivatives(len(scene.palette.matrix[0]), COLOR_DEGREE)
    chosen = np.argwhere(lowered)
    chosen = chosen[np.argsort(chosen[:, 2], kind="stable")]
    return {
        "camera": {
            "fullScale": FULL_SCALE,
            "read": camera.read_noise,
            "shot": camera.shot,
            "rounding": camera.step**2 / 12.0,
            "saturated": camera.saturated,
            "longest": camera.longest_exposure,
            "shots": camera.shots,
            "gains": list(camera.gains),
        },
        "sensor": {
            "plane": _flat(sensor.plane),
            "weights": _flat(sensor.weights),
            "places": _flat(sensor.places),
            "monomials": [[*map(int, entry), int(lowered[tuple(entry)])] for entry in chosen],
            "ridge": RIDGE,
            "leastDeviation": LEAST_DEVIATION,
        },
        "place": {
            "plane": _flat(place.plane),
            "weights": _flat(place.weights),
            "steepness": _flat(place.steepness),
            "prior": place.prior,
            "apart": _flat(place.apart),
        },
    }


def _flat(values: Array) -> list[float]:
    """Return values as the page has them: to 1e-6, which is a thousandth of a count in colors."""
    return [float(value) for value in values.round(6).ravel()]


def palette_facts(palette: Palette) -> dict[str, Any]:
    """Return the LEDs: names, keys and inks, what channels see of them and screens show of these.

    A letter is the first of the name, or the LED's number where others begin alike ("o" is off);
    what shines in some shots alone has their numbers behind it.
    """
    first = [name[0].upper() for name in palette.one_shot.names]
    letters = [
        letter if first.count(letter) == 1 and letter != "O" else str(number)
        for number, letter in enumerate(first, start=1)
    ]
    return {
        "names": list(palette.names),
        "shots": palette.shots,
        "letters": [
            letters[led] + name.partition("@")[2]
            for name, led in zip(palette.names, palette.led.tolist(), strict=True)
        ],
        "inks": list(palette.inks),
        "response": palette.matrix.tolist(),
        "display": palette.display.tolist(),
        "oneHue": palette.one_shot.one_hue,
    }


def large_pyramid(scene: Scene) -> Imprint:
    """Return one pyramid with the indenter's normals, large enough to be seen."""
    unit = scene.indenter.depth / scene.indenter.radius
    depth = min(TOUCH_DEPTH, 0.25 * scene.pad.thickness)
    room = 0.4 * min(scene.pad.width, scene.pad.length)
    return pyramids(
        unchecked(
            scene,
            {
                "sites": unchecked(scene.sites, {"columns": 1, "rows": 1, "carried": None}),
                "indenter": unchecked(scene.indenter, {"radius": min(depth / unit, room)}),
            },
        )
    )


def _touches(scene: Scene) -> Iterator[dict[str, Any]]:
    """Yield what can be pressed in; a body that the pad is too small for is left out."""
    bodies = ("Bolt", bolt), ("Ball", ball), ("Edge", straight_edge), ("Pyramid", large_pyramid)
    for title, make in bodies:
        try:
            body = make(scene)
        except SceneError:
            continue
        outline = _outline(body)
        yield {
            "name": title.lower(),
            "title": title,
            "planes": np.column_stack([body.normal, body.distance]).round(7).tolist(),
            "size": body.size,
            "reach": float(np.abs(outline).max()),
            "outline": "M" + "L".join(f"{x:.2f} {-y:.2f}" for x, y in outline) + "Z",
        }


def _outline(body: Imprint) -> Array:
    """Return the outline ``(point, 2)`` mm of a body in the coating's plane, from its center."""
    turn = np.linspace(0.0, 2 * np.pi, 96, endpoint=False)
    way = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    speed = way @ body.normal[:, :2].T
    with np.errstate(divide="ignore"):
        along = np.where(speed > 1e-9, body.distance / speed, np.inf).min(axis=1)
    return np.asarray(along[:, None] * way)


def _limits(limits: SearchLimits) -> dict[str, Any]:
    """Return the limits of a search; one interval of directions per fiber or more."""
    holder = limits.holder
    assert holder is not None  # `limits_of` always has one
    walls = {name: np.asarray(value).tolist() for name, value in asdict(holder).items()}
    return {
        "allowed": limits.allowed.tolist(),
        "led": limits.led.tolist(),
        "counts": limits.led_counts.tolist(),
        "most": len(limits.allowed) if limits.most_lit is None else limits.most_lit,
        "groups": [] if limits.exclusive is None else exclusive_groups(limits.exclusive),
        "budgets": [{"cost": one.cost.tolist(), "limit": one.limit} for one in limits.budgets],
        "ring": (
            np.arange(len(limits.allowed)) if limits.runs is None else limits.runs.ring
        ).tolist(),
        "runs": len(limits.allowed) if limits.runs is None else limits.runs.most,
        "ties": limits.groups.tolist(),
        "leading": limits.directions.leading.tolist(),
        "reflected": limits.directions.reflected.tolist(),
        "power": limits.led_power.tolist(),
        "low": limits.low.tolist(),
        "high": limits.high.tolist(),
        "step": limits.step,
        "holder": {**walls, "leastSine": LEAST_SINE},
    }
