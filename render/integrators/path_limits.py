"""Bidirectional paths between the emitters of any scene and the pixels of a film: what is shared.

All strategies (s light vertices, t camera vertices) are combined by the balance heuristic with
recursive sums (Georgiev 2012): emitters that a camera subpath meets (s = 0), direct light
(s = 1), joins of light and camera vertices (s, t >= 2), bridges over flat glossy faces
(``render.integrators.mirror_connections``), and light vertices projected onto the film (t = 1). No
path is ever stored: of each subpath a few vertices are kept, drawn by reservoirs.

Long scattering belongs to light subpaths. Camera subpaths pass two vertices in volumes, so that two
vertices that happen to be close make a join bright only if the camera's own last ones were close
as well. They are absorbed at the third one, and behind a diffuse surface at the first. A smooth
face, at which nothing can be joined, lets them pass two again: of light that is scattered once
between two such faces only camera subpaths know.

Strategies need not count alike in the balance heuristic: noisy ones whose light others find as well
count less (``GLOSSY``, ``render.integrators.film_sampler.PROJECTED``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.errors import RenderError

# Second event of the same vertex: direct light and reservoirs draw from here on.
SPARE = 2048
EVENTS = 2000
"""Events that one subpath may take, null boundaries included."""
GLOSSY = 0.1
"""What joins of a glossy camera vertex to a light vertex in a volume or on a diffuse surface count.

Narrow lobes make them noisy, while camera subpaths that go on from there meet the same light.
"""


@dataclass(frozen=True)
class PathLimits:
    """``max_depth`` edges per path (-1: no limit); Russian roulette from ``rr_depth`` on."""

    max_depth: int = -1
    rr_depth: int = 5

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            RenderError: names the parameter that is out of range.
        """
        if self.max_depth < 1 and self.max_depth != -1:
            raise RenderError(
                f"max_depth = {self.max_depth}, allowed: at least 1 edge, or -1 for no limit",
                field="max_depth",
                value=self.max_depth,
            )
        if self.rr_depth < 1:
            raise RenderError(
                f"rr_depth = {self.rr_depth}, allowed: at least 1",
                field="rr_depth",
                value=self.rr_depth,
            )

    def edges(self) -> Any:
        """Return the greatest number of edges as an opaque integer."""
        value = mi.UInt32(self.max_depth if self.max_depth >= 0 else 1 << 30)
        dr.make_opaque(value)
        return value

    def roulette(self) -> Any:
        """Return the first edge with Russian roulette as an opaque integer."""
        value = mi.UInt32(self.rr_depth)
        dr.make_opaque(value)
        return value


def survive(beta: Any, edges: Any, roulette: Any, number: Any) -> Any:
    """Return the weight of Russian roulette: 0 where the path ends."""
    keep = dr.clip(dr.max(beta), 0.05, 0.99)
    keep = dr.select(edges >= roulette, keep, 1.0)
    return dr.select(number < keep, dr.rcp(keep), 0.0)
