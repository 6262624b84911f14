"""States: named shapes of one skin, besides the one that it rests in.

The body is rigid: lower face, edges, lamps and camera stay where they are, and the skin alone moves
between the edges. A state is a sensor of its own, with one skin (`Scene.in_state`); what they share
is the material: sites keep their place on the skin.

A state of a mesh skin is another mesh of the same triangles with moved corners. Its heights are
sampled as those of any mesh (`render.scene.skin_mesh`). Where the skin went is read off the
triangles that the places of the grid lie in at rest: the same point of the material has the same
barycentric coordinates in the same triangle. Between the places it is a spline, as the height is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from render.arrays import Array
from render.scene.quantities import Part, Quantity, unchecked
from render.scene.sections import CarriedSites, Pad, Sites
from render.scene.skin import Skin
from render.scene.skin_mesh import MeshHeights, MeshSamples, closed_body, named_file, spline_through

if TYPE_CHECKING:
    import trimesh

STATE_NAME = r"^[a-z0-9][a-z0-9_-]{0,31}$"
REST = "rest"
"""Name of the state that ``skin`` and ``pad.thickness`` are of, the first of all."""
REST_REFUSED = "rest_refused"
"""Type of the problem of a state whose skin at rest has one of its own."""
NEWTON_STEPS = 12
"""Steps in which a place of the moved skin finds where it was at rest."""
LOST = 0.1
"""Length (mm) by which material may lie under the upper side of a moved body, where it is steep."""
LEAST_AREA = 0.05
"""Part of its area at rest, seen from above, to which skin may shrink."""


class MovedMesh(MeshHeights):
    """Heights of a state's upper side, and where the skin of the body at rest has moved to.

    Its file has the triangles of ``skin.mesh`` with moved corners, in the same coordinates.
    ``lift`` is the height of its highest sample over that at rest, mm; ``across`` and ``along`` are
    how far material moves in x and y, mm, rows along y, at the samples' places of the rest.
    """

    lift: float
    across: tuple[float, ...]
    along: tuple[float, ...]

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, raw: Any, info: ValidationInfo) -> Any:
        path = named_file(raw, info)
        named = (info.context or {}).get("rest_mesh")
        if named is None:
            raise ValueError(
                "it has no triangles to follow, allowed: a mesh where skin.shape = mesh, and a "
                "radius where it is a dome or an arch"
            )
        moved, _ = closed_body(path, info)
        try:
            rest, _ = closed_body((info.context or {}).get("folder", Path()) / named, info)
            at_rest = MeshSamples.of(rest)
        except ValueError:
            raise PydanticCustomError(
                REST_REFUSED, "it follows skin.mesh, which is refused: mend that first"
            ) from None
        _check_topology(moved, rest, path.name, Path(named).name)
        return _moved_content(at_rest, moved, path.name)

    @property
    def sentence(self) -> str:
        """The mesh in words."""
        farthest = float(np.hypot(self.across, self.along).max())
        return (
            f"mesh with its crown {self.lift:+.3g} mm over that at rest, skin moved aside by up to "
            f"{farthest:.3g} mm"
        )

    @property
    def upper_side(self) -> MeshHeights:
        """Its heights alone."""
        return MeshHeights.model_construct(sides=self.sides, heights=self.heights)

    def places(self, uv: Array) -> Array:
        """Return x and y ``(..., 2)`` mm in this state of the skin that is at ``uv`` at rest."""
        x, y = self._inside(uv[..., 0], uv[..., 1])
        moved = [spline_through(self.sides, part).ev(y, x) for part in (self.across, self.along)]
        half = 0.5 * np.array(self.sides)
        return np.asarray(np.clip(np.stack([x + moved[0], y + moved[1]], axis=-1), -half, half))

    def gradient(self, uv: Array) -> Array:
        """Return the derivatives ``(..., 2, 2)`` of `places` by u and v, before the clip."""
        x, y = self._inside(uv[..., 0], uv[..., 1])
        splines = [spline_through(self.sides, part) for part in (self.across, self.along)]
        rows = [np.stack([s.ev(y, x, dy=1), s.ev(y, x, dx=1)], axis=-1) for s in splines]
        return np.asarray(np.eye(2) + np.stack(rows, axis=-2))

    def rest_places(self, places: Array) -> Array:
        """Return ``uv`` ``(..., 2)`` of the skin that is at ``places``: the inverse of `places`."""
        half = 0.5 * np.array(self.sides)
        uv = np.clip(places, -half, half)
        for _ in range(NEWTON_STEPS):
            step = np.linalg.solve(self.gradient(uv), (places - self.places(uv))[..., None])
            uv = np.clip(uv + step[..., 0], -half, half)
        return np.asarray(uv)


class State(Part):
    """A shape that the skin takes besides the one at rest.

    ``mesh`` is the body in that shape, where skin.shape is mesh: the same triangles with moved
    corners, in the same coordinates. ``radius`` is that of a dome or an arch, whose skin moves
    straight up or down, and ``thickness`` the height of its crown, that of the pad unless given.
    """

    name: Annotated[str, Field(pattern=STATE_NAME)]
    mesh: MovedMesh | None = None
    radius: Annotated[float, Quantity("mm", 1.0, 10000.0)] | None = None
    thickness: Annotated[float, Quantity("mm", 0.1, 1000.0)] | None = None

    def skin_of(self, rest: Skin) -> Skin:
        """Return the skin in this state."""
        if self.mesh is None:
            return unchecked(rest, {"radius": self.radius})
        return unchecked(rest, {"mesh": self.mesh.upper_side})

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
    states: tuple[State, ...], skin: Skin | None, pad: Pad, angles: tuple[float, ...]
) -> Iterator[str]:
    """Yield what is wrong with the list of states, whatever their shapes, one sentence each."""
    if not states:
        yield "states: none is listed, leave the key out"
    if skin is None:
        yield (
            "states: the skin is flat, allowed: with a [skin]; the states of a slab are its "
            "bending.angles"
        )
    if skin is not None and any(angles):
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
    if skin is not None:
        yield from _equal_shapes(states, skin, pad)


def _equal_shapes(states: tuple[State, ...], skin: Skin, pad: Pad) -> Iterator[str]:
    """Yield which states are one shape under two names: it would count twice in every score."""
    shapes: dict[Any, list[str]] = {}
    for name, state in [(REST, None), *((state.name, state) for state in states)]:
        shape = _shape_at_rest(skin, pad) if state is None else _shape_of(state, pad)
        if shape is not None:
            shapes.setdefault(shape, []).append(name)
    for names in shapes.values():
        if len(names) > 1:
            yield (
                f"states: {' and '.join(names)} have one shape, allowed: distinct shapes, since "
                "each counts in the score; leave one out"
            )


def _shape_at_rest(skin: Skin, pad: Pad) -> Any:
    """Return what the shape at rest is equal by, in the form of `_shape_of`."""
    if skin.mesh is None:
        return skin.radius, pad.thickness
    still = (0.0,) * len(skin.mesh.heights)
    return skin.mesh.sides, skin.mesh.heights, 0.0, still, still


def _shape_of(state: State, pad: Pad) -> Any:
    """Return what the shape of a state is equal by; None where it names none."""
    mesh = state.mesh
    if mesh is not None:
        return mesh.sides, mesh.heights, mesh.lift, mesh.across, mesh.along
    return None if state.radius is None else (state.radius, state.thickness or pad.thickness)


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
        at = ", ".join(f"{round(value, 3) + 0.0:g}" for value in places[site])
        yield (
            f"states: in {name} site {site} is at ({at}) mm, where its pyramid leaves the pad, "
            "allowed: within it; move the sites"
        )


def _check_topology(moved: trimesh.Trimesh, rest: trimesh.Trimesh, name: str, of: str) -> None:
    """Refuse a mesh whose triangles are not those of the rest, in the order of the file."""
    for word, here, there in (
        ("triangles", len(moved.faces), len(rest.faces)),
        ("corners", len(moved.vertices), len(rest.vertices)),
    ):
        if here != there:
            raise ValueError(
                f"{name} has {here} {word} and {of} has {there}, allowed: the same triangles with "
                "moved corners"
            )
    # Corners by the place in the file where each is met first: readers number them as they like.
    first = [
        np.unique(mesh.faces, return_index=True, return_inverse=True)[1:] for mesh in (moved, rest)
    ]
    met = [index[inverse.ravel()].reshape(-1, 3) for index, inverse in first]
    other = np.flatnonzero((met[0] != met[1]).any(axis=1))
    if len(other):
        raise ValueError(
            f"{name} joins other corners than {of} in {len(other)} of {len(rest.faces)} triangles, "
            f"the first is number {other[0]}, allowed: the same triangles with moved corners"
        )


def _moved_content(at_rest: MeshSamples, moved: trimesh.Trimesh, name: str) -> dict[str, Any]:
    """Return the fields of a `MovedMesh`; moves are rounded as heights are."""
    here = MeshSamples.of(moved)
    corners = np.asarray(moved.triangles)[at_rest.triangle]
    u, v = at_rest.weights[..., 0, None], at_rest.weights[..., 1, None]
    place = corners[..., 0, :] * (1 - u - v) + corners[..., 1, :] * u + corners[..., 2, :] * v
    shift = np.round(place[..., :2] - at_rest.places, 6) + 0.0
    content: dict[str, Any] = {
        "sides": tuple(here.sides.tolist()),
        "heights": tuple(here.heights.ravel().tolist()),
        "lift": round(float(here.highest - at_rest.highest), 6),
        "across": tuple(shift[..., 0].ravel().tolist()),
        "along": tuple(shift[..., 1].ravel().tolist()),
    }
    mesh = MovedMesh.model_construct(**content)
    area = np.linalg.det(mesh.gradient(at_rest.places))
    upper = here.highest + mesh.rise(place[..., 0], place[..., 1]) + mesh.crown
    lost = (area < LEAST_AREA) | (np.abs(upper - place[..., 2]) > LOST)
    if lost.any():
        row, column = np.argwhere(lost)[0]
        x, y = at_rest.places[row, column]
        raise ValueError(
            f"{name} folds: skin that is at x = {x:.3g}, y = {y:.3g} mm at rest lies under other "
            f"skin, or is squeezed to less than {LEAST_AREA:.0%} of its area, allowed: an upper "
            "side that one sees whole from above"
        )
    return content
