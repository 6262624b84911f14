"""Mirror images of lamps: at x = 0 or y = 0, seen from outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from render.arrays import Array
from render.scene.lamps import Edge, PlacedLamp
from render.scene.places.rail_places import CandidateLamp

Mirror = Literal["x", "y"]
SIGNS = {"x": np.array([-1.0, 1.0, 1.0]), "y": np.array([1.0, -1.0, 1.0])}
OPPOSITE: dict[Mirror, dict[Edge, Edge]] = {
    "x": {"left": "right", "right": "left"},
    "y": {"tip": "base", "base": "tip"},
}
NEAR = 1e-3
"""mm, and of unit vectors: what is nearer is mirrored."""


def image_of(candidate: CandidateLamp, mirror: Mirror) -> CandidateLamp:
    """Return the image of a place; the place itself where that is its own."""
    sign = SIGNS[mirror]
    if _alike(candidate.position * sign, candidate.position, candidate.direction * sign,
              candidate.direction):  # fmt: skip
        return candidate
    edge = candidate.edge
    return replace(
        candidate,
        position=candidate.position * sign + 0.0,
        direction=candidate.direction * sign + 0.0,
        edge=None if edge is None else OPPOSITE[mirror].get(edge, edge),
        image=True,
    )


def images(lamps: Sequence[PlacedLamp], mirror: Mirror) -> tuple[int | None, ...]:
    """Return the number of each lamp's image, its own where it is that, None where it has none."""
    position = np.array([lamp.position for lamp in lamps])
    beam, sign = np.array([lamp.beam for lamp in lamps]), SIGNS[mirror]
    found: list[int | None] = []
    for lamp in lamps:
        near = (np.abs(position - lamp.position * sign).max(axis=1) < NEAR) & (
            np.abs(beam - lamp.beam * sign).max(axis=1) < NEAR
        )
        same = [
            number
            for number, other in enumerate(lamps)
            if near[number] and _body(other) == _body(lamp)
        ]
        found.append(same[0] if same else None)
    return tuple(found)


def _body(lamp: PlacedLamp) -> tuple[object, ...]:
    return lamp.diameter, lamp.profile, lamp.turns


def _alike(place: Array, other: Array, beam: Array, other_beam: Array) -> bool:
    return bool(max(np.abs(place - other).max(), np.abs(beam - other_beam).max()) < NEAR)
