"""States: named shapes of one skin, besides the one that it rests in.

The body is rigid: lower face, edges, lamps and camera stay where they are, and the skin alone moves
between the edges. A state is a sensor of its own, with one skin (`Scene.in_state`); what they share
is the material: sites keep their place on the skin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from render.arrays import Array
from render.scene.moved_mesh import MovedMesh
from render.scene.parts import CarriedSites, Pad, Sites
from render.scene.quantities import Part, Quantity
from render.scene.skin import Skin

REST = "rest"
"""Name of the state that ``skin`` and ``pad.thickness`` are of, the first of all."""


class State(Part):
    """A shape that the skin takes besides the one at rest.

    ``mesh`` is the body in that shape, where skin.shape is mesh: the same triangles with moved
    corners, in the same coordinates. ``radius`` is that of a dome or an arch, whose skin moves
    straight up or down, and ``thickness`` the height of its crown, that of the pad unless given.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")]
    mesh: MovedMesh | None = None
    radius: Annotated[float, Quantity("mm", 1.0, 10000.0)] | None = None
    thickness: Annotated[float, Quantity("mm", 0.1, 1000.0)] | None = None

    def skin_of(self, rest: Skin) -> Skin:
        """Return the skin in this state."""
        if self.mesh is None:
            return rest.model_copy(update={"radius": self.radius})
        return rest.model_copy(update={"mesh": self.mesh.upper_side})

    def crown_of(self, rest: Skin, pad: Pad) -> float:
        """Return the height (mm) of the crown over the lower face."""
        if self.mesh is None or rest.mesh is None:
            return self.thickness or pad.thickness
        return pad.thickness + self.mesh.lift + self.mesh.crown - rest.mesh.crown

    def places(self, uv: Array) -> Array:
        """Return x and y ``(..., 2)`` mm of the skin that is at ``uv`` at rest."""
        return uv if self.mesh is None else self.mesh.places(uv)

    def rest_places(self, places: Array) -> Array:
        """Return ``uv`` ``(..., 2)`` mm at rest of the skin that is at ``places``."""
        return places if self.mesh is None else self.mesh.rest_places(places)

    def turns(self, uv: Array) -> Array:
        """Return by how much (rad, from +x to +y) the skin at ``uv`` turns about its normal.

        The rotation in the polar decomposition of the move, seen from above: 0 where it stretches.
        """
        if self.mesh is None:
            return np.zeros(uv.shape[:-1])
        (a, b), (c, d) = np.moveaxis(self.mesh.gradient(uv), (-2, -1), (0, 1))
        return np.asarray(np.arctan2(c - b, a + d))

    def carried(self, sites: Sites) -> CarriedSites | None:
        """Return where the sites are in this state; None where they stay in x and y."""
        uv = sites.places
        places, turns = self.places(uv), self.turns(uv)
        if (places == uv).all() and not turns.any():
            return None
        x, y = places.T.tolist()
        return CarriedSites.model_construct(x=tuple(x), y=tuple(y), turn=tuple(turns.tolist()))


def state_problems(
    states: tuple[State, ...], skin: Skin | None, angles: tuple[float, ...]
) -> Iterator[str]:
    """Yield what is wrong with the list of states, whatever their shapes, one sentence each."""
    if not states:
        yield "states: none is listed, leave the key out"
    if skin is None:
        yield (
            "states: the skin is flat, allowed: with a [skin]; the states of a slab are its "
            "bending.angles"
        )
    if any(angles):
        shown = ", ".join(f"{math.degrees(angle):g}" for angle in angles)
        yield f"states: bending.angles = {shown} deg, allowed beside states: 0 deg alone"
    names = [REST, *(state.name for state in states)]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield (
            f"states: the name {name} is there {names.count(name)} times"
            f"{', once for skin itself' if name == REST else ''}, allowed: once each"
        )
    for number, state in enumerate(states) if skin is not None else ():
        key = f"states.{number}"
        if skin is not None and skin.shape == "mesh":
            if state.mesh is None:
                yield f"missing key {key}.mesh"
            for name in ("radius", "thickness"):
                if getattr(state, name) is not None:
                    yield f"{key}.{name}: a mesh has its own, leave it out"
        elif state.radius is None:
            yield f"missing key {key}.radius"


def site_problems(sites: Sites, pad: Pad, clearance: float, name: str) -> Iterator[str]:
    """Yield what is wrong with the sites as a state carries them; ``clearance`` in mm."""
    places = sites.places
    apart = np.abs(places[:, None] - places[None]).max(axis=-1)
    apart[np.diag_indices(len(places))] = np.inf
    if apart.min() < 2 * clearance:
        a, b = sorted(int(k) for k in np.unravel_index(apart.argmin(), apart.shape))
        yield (
            f"states: in {name} sites {a} and {b} are {apart.min():.4g} mm apart, so that pyramids "
            f"overlap, allowed: at least 3 indenter.radius = {2 * clearance:g} mm"
        )
    room = np.array([pad.width, pad.length]) / 2 - clearance - np.abs(places)
    for site in np.flatnonzero(room.min(axis=1) < 0)[:1]:
        at = ", ".join(f"{value:.3g}" for value in places[site])
        yield (
            f"states: in {name} site {site} is at ({at}) mm, where its pyramid leaves the pad, "
            "allowed: within it; move the sites"
        )
