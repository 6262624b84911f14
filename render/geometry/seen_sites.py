"""Which sites count: those that the camera sees whole.

A facet is seen where at least one pixel shows nothing else (`render.geometry.visibility`). The
metric compares the facets of a site with each other, and the score the same sites at every bend.
So a site counts where, at every bend of the scene, each of its facets and its spot of the untouched
pad is seen. The others are pressed as well, but have no cells: nothing is rendered for them, and
they are no part of the score.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.errors import SceneError
from render.geometry.camera_rays import camera_origin, half_view, pixel_positions
from render.geometry.layout import declared_sites, facets
from render.geometry.refraction import aim_at, refract_into_pad
from render.geometry.visibility import facet_masks, first_facet, shown_targets
from render.scene import MOST_PIXELS, Scene, unchecked

OUTSIDE, HIDDEN, SMALL = "outside the picture", "hidden", "smaller than a pixel"

WIDEST = 170.0
"""Field of view in degrees up to which a wider one is called a remedy."""
_LARGER, _LOWER = range(2, 17), range(75, 0, -5)
"""Factors of pixels and slopes (deg) that are tried for a remedy."""


@dataclass(frozen=True, eq=False)
class CameraCoverage:
    """What the camera sees of a scene.

    Arguments:
        seen: ``(bend, site, facet + 1)``; the last is the untouched spot of the site.
        unseen: number of facets that are not seen, over all bends, by cause.
        word: what the first axis has, as `Scene.state_word` has it.
    """

    seen: NDArray[np.bool_]
    unseen: dict[str, int]
    word: str = ""

    @property
    def counted(self) -> NDArray[np.int64]:
        """The sites that count, ascending, numbered as the file declares them."""
        return np.nonzero(self.seen.all(axis=(0, 2)))[0]

    @property
    def sentence(self) -> str:
        """How many sites count, and why the others do not."""
        sites = self.seen.shape[1]
        facets_seen = self.seen[..., :-1]
        text = (
            f"{len(self.counted)} of {sites} sites count, and {facets_seen.sum()} of "
            f"{facets_seen.size} facets are seen"
        )
        if self.word:
            text += f" (over {len(self.seen)} {self.word}s)"
        if self.seen.all():
            return text
        causes = ", ".join(f"{number} {cause}" for cause, number in self.unseen.items() if number)
        out = sorted(set(range(sites)) - set(self.counted.tolist()))
        return f"{text}; facets not seen: {causes}; sites left out: {', '.join(map(str, out))}"


@lru_cache(maxsize=64)
def camera_coverage(scene: Scene) -> CameraCoverage:
    """Return what the camera sees at the bends of ``scene``; nothing is drawn for it."""
    seen, unseen = [], dict.fromkeys((OUTSIDE, HIDDEN, SMALL), 0)
    for one, bend in _states(scene):
        shown = seen_targets(one, bend)
        seen.append(shown)
        for cause, number in _causes(one, bend, shown).items():
            unseen[cause] += number
    return CameraCoverage(np.stack(seen), unseen, scene.state_word)


def _states(scene: Scene) -> Iterator[tuple[Scene, float]]:
    """Yield what the camera sees: the scene at each of its bends, or in each of its states."""
    for value in scene.state_axis:
        yield (scene, value) if scene.states is None else (scene.in_state(value), 0.0)


def counted_sites(scene: Scene) -> NDArray[np.int64]:
    """Return the sites that count, ascending, numbered as the file declares them.

    Raises:
        SceneError: there is none.
    """
    carried = scene.sites.carried
    if carried is not None and carried.counted:
        return np.array(carried.counted)
    coverage = camera_coverage(scene)
    if len(coverage.counted):
        return coverage.counted
    facets_seen = coverage.seen[..., :-1]
    causes = ", ".join(f"{n} {cause}" for cause, n in coverage.unseen.items() if n)
    raise SceneError(
        f"the camera sees none of {coverage.seen.shape[1]} sites whole"
        f"{_everywhere(scene.state_word)}, and {facets_seen.sum()} of {facets_seen.size} "
        f"facets ({causes}), at least one site is needed: {_remedy(scene, coverage)}",
        field="camera",
    )


def seen_rule(word: str) -> str:
    """Return which sites count, by what states are (`Scene.state_word`)."""
    return (
        "a site counts where each of its facets and its untouched spot has a pixel for itself"
        f"{_everywhere(word)}"
    )


def _everywhere(word: str) -> str:
    return {"": "", "bend": " at every bend", "state": " in every state"}[word]


def _remedy(scene: Scene, coverage: CameraCoverage) -> str:
    """Return what helps against the most frequent cause."""
    camera = scene.camera
    cause = max(coverage.unseen, key=coverage.unseen.__getitem__)
    if cause == HIDDEN:
        slope = np.degrees(scene.indenter.slope)
        lower = next((f" to {s:g} deg" for s in _LOWER if s < slope and _sees(scene, s)), "")
        return f"move the camera, or lower indenter.slope = {slope:g} deg{lower}"
    if cause == SMALL:
        sizes = [(factor * camera.columns, factor * camera.rows) for factor in _LARGER]
        sizes = [size for size in sizes if max(size) <= MOST_PIXELS]
        finer = next((f" to {w} and {h}" for w, h in sizes if _sees(scene, pixels=(w, h))), "")
        return f"raise camera.columns = {camera.columns} and camera.rows = {camera.rows}{finer}"
    corners = [(*state, facets(*state).corners.reshape(-1, 3)) for state in _states(scene)]
    position = np.stack([_image_of(*corner)[0] for corner in corners])
    widest = np.abs(2 * position / [camera.columns, camera.rows] - 1).max()  # NaN stays
    half = widest * half_view(scene, camera.columns, camera.rows)[1]
    needed = 2 * np.degrees(half if camera.fisheye else np.arctan(half))
    if not needed < WIDEST:
        x, y, z = np.concatenate([facets(*state).site_position for state in _states(scene)]).mean(0)
        return (
            f"it stands at {_place(camera.place)} mm and looks along {_place(camera.axes[2])}, the "
            f"sites lie about {_place((x, y, z))} mm: turn or move the camera, or move the sites"
        )
    return (
        f"widen camera.field_of_view = {np.degrees(camera.field_of_view):g} deg to "
        f"{np.ceil(needed):g} deg, or move the camera or the sites"
    )


def _sees(scene: Scene, slope: float | None = None, pixels: tuple[int, int] | None = None) -> bool:
    """Return whether a site counts with another ``slope`` (deg), or columns and rows of pixels."""
    update: dict[str, object] = {}
    if slope is not None:
        update["indenter"] = unchecked(scene.indenter, {"slope": np.radians(slope)})
    if pixels is not None:
        size = {"columns": pixels[0], "rows": pixels[1]}
        update["camera"] = unchecked(scene.camera, size)
    return len(camera_coverage(unchecked(scene, update)).counted) > 0


def _place(vector: tuple[float, ...]) -> str:
    return f"({', '.join(f'{round(float(value), 2) + 0.0:g}' for value in vector)})"


def check_seen(scene: Scene, bends: Array) -> None:
    """Refuse ``bends`` (rad) at which the camera does not see a site that counts.

    The states of a scene are all that it has: others are refused too.

    Raises:
        SceneError: names the bend, the site and what to do.
    """
    counted = counted_sites(scene)
    for bend in set(bends.tolist()) - set(scene.state_axis):
        hidden = np.argwhere(~seen_targets(scene, bend)[counted])
        if len(hidden):
            raise SceneError(
                f"the camera does not see {len(hidden)} facets and spots at a bend of "
                f"{np.degrees(bend):.4g} deg, the first of site {counted[hidden[0, 0]]}, which "
                "counts at bending.angles: name that bend there too, so that the site is left out, "
                f"or raise camera.columns = {scene.camera.columns} and camera.rows = "
                f"{scene.camera.rows}",
                field="bending.angles",
            )


def flat_sites(scene: Scene) -> Array:
    """Return the centers of the sites that count on the flat coating, ``(site, 3)`` mm.

    In the order of the file; this is the ``site`` axis of all arrays.

    Raises:
        SceneError: none counts.
    """
    return declared_sites(scene)[counted_sites(scene)]


def seen_targets(scene: Scene, bend: float) -> NDArray[np.bool_]:
    """Return whether the camera sees each facet, and last the spot, ``(site, facet + 1)``.

    ``bend`` in rad; sites are those that the file declares.
    """
    place = facets(scene, bend)
    points = np.concatenate([place.centroid, place.site_position[:, None]], axis=1)
    shown = np.zeros(points.shape[:2], dtype=bool)
    pixel = np.floor(np.nan_to_num(_image_of(scene, bend, points.reshape(-1, 3))[0], nan=-9.0))
    # Most targets have the pixel for themselves that shows their middle, or one beside it.
    for reach in (0, 1):
        wanted = pixel[~shown.ravel()].astype(int)
        step = np.arange(-reach, reach + 1)
        row, column = np.broadcast_arrays(
            wanted[:, 1, None, None] + step[:, None], wanted[:, 0, None, None] + step
        )
        inside = (row >= 0) & (row < scene.camera.rows)
        inside &= (column >= 0) & (column < scene.camera.columns)
        near = np.unique((row * scene.camera.columns + column)[inside])
        shown.flat[shown_targets(scene, bend, near)] = True
        if shown.all():
            return shown
    return facet_masks(scene, bend).counts > 0


def _causes(scene: Scene, bend: float, shown: NDArray[np.bool_]) -> dict[str, int]:
    """Return how many facets are not ``shown`` ``(site, facet + 1)``, by cause."""
    site, facet = np.nonzero(~shown[:, :-1])
    if not len(site):
        return {}
    position, direction, reached = _image_of(scene, bend, facets(scene, bend).centroid[site, facet])
    size = np.array([scene.camera.columns, scene.camera.rows])
    outside = ~((position >= 0) & (position < size)).all(axis=1)
    rays = refract_into_pad(scene, bend, camera_origin(scene), direction)
    met = first_facet(scene, bend, rays, 0.0) == site * (scene.indenter.faces + 1) + facet
    hidden = ~outside & ~(met & reached)
    small = len(site) - int(outside.sum()) - int(hidden.sum())
    return {OUTSIDE: int(outside.sum()), HIDDEN: int(hidden.sum()), SMALL: small}


def _image_of(scene: Scene, bend: float, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return where ``points`` ``(n, 3)`` in the pad appear, and `aim_at` them."""
    direction, reached = aim_at(scene, bend, camera_origin(scene), points)
    size = scene.camera.columns, scene.camera.rows
    return pixel_positions(scene, *size, direction), direction, reached
