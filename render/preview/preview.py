"""The preview, level 0: transport and pictures from one shading function, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.errors import DesignError, GraphicsError
from render.geometry import HeightMap, Imprint, counted_sites, pyramids
from render.preview.bonded import with_bonded_window
from render.preview.facet_blur import facet_blur
from render.preview.lights import PointLights, point_lights
from render.preview.passes import MAX_TARGET_SIDE, Points, ShaderPasses
from render.preview.radiosity import Radiosity, solve_radiosity
from render.preview.shading_points import shading_points
from render.preview.sight import Sight
from render.preview.sloped_skin import slope_terms, sloped_skin
from render.preview.superposition import LightTable, light_table
from render.scene import Scene

KEPT_PIXELS = 2**20
"""Pixels of pictures whose sight is kept for the next design."""


@dataclass(frozen=True, eq=False)
class PictureView:
    """One picture as far as it does not depend on the design.

    Arguments:
        sight: what its pixels see.
        light: direct light there.
    """

    sight: Sight
    light: LightTable


class Preview:
    """Draws one scene with OpenGL; a context manager that frees the OpenGL context.

    Radiance at the camera in 1/(mm^2 sr) per unit power of a fiber: direct light of its glow at
    every facet (straight and by way of the lower face), radiosity, and the camera's view.
    Nothing in it is fitted to the reference.

    Arguments:
        scene: the sensor; the shader is specialized to what it declares.
        backend: ``osmesa`` or ``egl``; None takes the first that works.
        cache: folder of cached slab responses; None is the user's cache.
        lights: what the fibers make of the scene, instead of the cached response.
        imprint: what is pressed into pictures; None is the pyramids, which alone have transport.

    Example::

        with Preview(load_scene("finger20")) as preview:
            T, background = preview.transport(phi=np.array([np.pi / 2]), bends=np.array([0.0]))
    """

    def __init__(
        self,
        scene: Scene,
        *,
        backend: str | None = None,
        cache: Path | None = None,
        lights: PointLights | None = None,
        imprint: Imprint | HeightMap | None = None,
    ) -> None:
        """Make the lights, open the context, upload what does not depend on the design."""
        self.scene = scene = with_bonded_window(scene)
        self._lights = lights or point_lights(scene, cache)
        pressed = imprint or pyramids(scene)
        self._measures = imprint is None
        self._counted = counted_sites(scene)
        self._skin = isinstance(pressed, HeightMap)
        self._faces = sloped_skin(scene, pressed) if isinstance(pressed, HeightMap) else pressed
        self._points = shading_points(scene, self._faces)
        self._views: dict[tuple[float, tuple[int, int], bool], PictureView] = {}
        self._lit: dict[float, LightTable] = {}
        self._radiosity: dict[float, Radiosity] = {}
        self._blurs: dict[float, Array] = {}
        self._tables: dict[float, Array] = {}
        self._passes: ShaderPasses | None = ShaderPasses(
            scene, self._lights, self._points, pressed, backend
        )

    def __enter__(self) -> Preview:
        """Return the preview itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the OpenGL context."""
        self.close()

    def close(self) -> None:
        """Free the OpenGL context; nothing can be drawn afterwards."""
        if self._passes is not None:
            self._passes.release()
            self._passes = None

    def transport(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return T and background, float64 (drawn in float32).

        Arguments:
            phi: ``(node,)`` rad, the same for all fibers, or ``(fiber, node)``.
            bends: ``(bend,)`` rad in [0, pi].

        Returns:
            T ``(fiber, node, bend, site, facet)`` and background ``(fiber, node, bend, site)``.
        """
        fibers = self.scene.lamp_count
        phi = np.asarray(phi, dtype=np.float64)
        if phi.ndim == 1:
            phi = np.tile(phi, (fibers, 1))
        self._check(phi, np.asarray(bends))
        if not self._measures:
            raise GraphicsError("only the pyramids have transport: make a preview without imprint")
        seen = np.stack([self._seen(phi, float(bend)) for bend in bends], axis=2)
        return seen[..., :-1], seen[..., -1]

    def _seen(self, phi: Array, bend: float) -> Array:
        """Return T and, as last facet, the background: ``(fiber, node, site, facet + 1)``."""
        nodes = self._lights.nodes
        if nodes is None:
            size = max(1, MAX_TARGET_SIDE // len(phi))
            parts = range(0, phi.shape[1], size)
            return np.concatenate([self.draw(phi[:, i : i + size], bend) for i in parts], axis=1)
        if bend not in self._tables:
            self._tables[bend] = self.draw(np.tile(nodes, (len(phi), 1)), bend)
        # Emission is a polynomial in phi through its nodes, and radiance is linear in emission.
        weights = interpolation_weights(nodes, phi)
        return np.asarray(np.einsum("fjn,fnsk->fjsk", weights, self._tables[bend]))

    def skin(self, phi: Array, bends: Array) -> Array:
        """Return irradiance on the untouched coating, ``(fiber, node, bend, row, column)``.

        The middles of even cells of the pad, rows from the base and columns from -x. Unit: 1/mm^2
        per unit power of a fiber.

        Arguments:
            phi: ``(node,)`` rad.
            bends: ``(bend,)`` rad.
        """
        points = self._points
        every = np.tile(np.asarray(phi, dtype=np.float64), (self.scene.lamp_count, 1))
        self._check(every, np.asarray(bends))
        seen = []
        for bend in bends:
            direct = self.direct_irradiance(every, float(bend)).reshape(every.size, -1, 2)[..., 0]
            added = self._radiosity_at(float(bend)).added(direct)
            total = (direct[:, : points.first_edge] + added)[:, points.first_patch :]
            seen.append(total.reshape(*every.shape, points.rows, points.columns))
        return np.stack(seen, axis=2)

    def draw(self, phi: Array, bend: float) -> Array:
        """Draw all cells at one bend: ``(fiber, node, site, facet + 1)``, the last the background.

        ``phi`` is ``(fiber, node)`` rad. `transport` gives the same and draws only when it must.
        """
        points, radiosity, weights = self._points, self._radiosity_at(bend), self._blur_at(bend)
        drawn = self.direct_irradiance(phi, bend).reshape(phi.size, -1, 2)
        direct, foot = drawn[..., 0], drawn[..., 1]
        total = direct[:, : points.first_edge] + radiosity.added(direct)
        shape = (phi.size, points.sites, points.facets)
        facets = slice(0, points.sites * points.facets)
        site = total[:, facets.stop : points.first_patch, None]
        # At the foot of a facet the pyramid's shadow leaves what the site gets indirectly.
        shadow = site - direct[:, facets.stop : points.first_patch, None]
        around = foot[:, facets].reshape(shape) + shadow
        facet = total[:, facets].reshape(shape) + radiosity.below(around)
        facet, around, site = (part[:, self._counted] for part in (facet, around, site))
        blur = weights[:, :-1]
        seen = np.einsum("sij,rsj->rsi", blur[..., :-1], facet) + blur[..., -1] * around
        background = weights[:, -1, -1:] * site
        cells = np.concatenate([seen, background], axis=-1)
        return cells.reshape(*phi.shape, len(self._counted), -1)

    def direct_irradiance(self, phi: Array, bend: float) -> Array:
        """Draw the light that has met nothing but clear faces, ``(fiber, node, point, 2)``.

        The second is that of the coating at the foot of a point's facet, without what the pyramid
        hides. ``phi`` is ``(fiber, node)`` rad; the points are those of
        `render.preview.shading_points`. Unit: 1/mm^2 per unit power of a fiber.
        """
        emission = self._lights.emission(phi.T).swapaxes(0, 1)
        return self._open.direct(emission, bend).astype(np.float64)

    def picture(
        self,
        phi: Array,
        power: Array,
        bend: float,
        width: int,
        height: int,
        indented: bool = True,
    ) -> NDArray[np.float32]:
        """Return linear radiance ``(height, width, channel)`` of the pad as the camera sees it.

        Arguments:
            phi: ``(fiber,)`` rad.
            power: ``(fiber, channel)``, what fibers give to the channels.
            bend: rad in [0, pi].
            width: columns of pixels.
            height: rows of pixels, over which the camera's field of view spreads.
            indented: pressed by the imprint, or untouched.

        x runs to the right and the tip is up; what is not pad is 0.
        """
        phi, power = np.asarray(phi, dtype=np.float64), np.asarray(power, dtype=np.float64)
        self._check(phi[:, None], np.array([bend]))
        channels = len(self.scene.palette.channels)
        if power.shape != (len(phi), channels) or not np.isfinite(power).all():
            raise DesignError(
                f"power has shape {power.shape}, allowed: finite numbers, ({len(phi)}, {channels})",
                field="power",
            )
        # Pictures of three channels each, the last ones dark where there are fewer.
        power = np.pad(power, [(0, 0), (0, -channels % 3)])
        parts = [
            self._picture(phi, power[:, first : first + 3], bend, (width, height), indented)
            for first in range(0, channels, 3)
        ]
        return np.concatenate(parts, axis=-1)[..., :channels]

    def sight(self, bend: float, width: int, height: int, indented: bool = True) -> Sight:
        """Return which places of the skin the pixels of `picture` see, whatever the light."""
        self._check(np.zeros((self.scene.lamp_count, 1)), np.array([bend]))
        return self._view(bend, (width, height), indented).sight

    def _picture(
        self, phi: Array, power: Array, bend: float, size: tuple[int, int], indented: bool
    ) -> NDArray[np.float32]:
        """Return three channels of a picture, ``power`` ``(fiber, 3)``."""
        view, points = self._view(bend, size, indented), self._points
        if bend not in self._lit:
            self._lit[bend] = self._table(self._open.points, bend)
        direct, light = (each.of(phi, power) for each in (self._lit[bend], view.light))
        radiosity, sight = self._radiosity_at(bend), view.sight
        indirect = radiosity.added(direct.astype(np.float64))
        coating = indirect[:, points.first_patch :].reshape(3, points.rows, points.columns)
        facets, sites = np.split(
            indirect[:, : points.first_patch], [points.sites * points.facets], 1
        )
        facet = facets.reshape(3, points.sites, points.facets) + radiosity.below(sites[..., None])
        if not indented:
            added = sight.on_coating(coating)
        elif self._skin:
            added = sight.on_slopes(
                coating, slope_terms(self._faces, (facet - sites[..., None])[:, 0])
            )
        else:
            added = sight.on_facets(coating, facet)
        return sight.picture(light + added)

    def _view(self, bend: float, size: tuple[int, int], indented: bool) -> PictureView:
        """Return what a picture sees, drawn when it is first asked for; the last few are kept."""
        key, passes = (bend, size, indented), self._open
        if key not in self._views:
            while (
                self._views
                and sum(len(view.sight.pixel) for view in self._views.values()) + size[0] * size[1]
                > KEPT_PIXELS
            ):
                passes.forget(self._views.pop(next(iter(self._views))).light.points)
            sight = passes.sight(bend, size, indented)
            pixels = passes.pixels_of(sight, indented)
            self._views[key] = PictureView(sight, self._table(pixels, bend))
        return self._views[key]

    def _table(self, points: Points, bend: float) -> LightTable:
        return light_table(self.scene, self._open, self._lights, points, bend)

    @property
    def _open(self) -> ShaderPasses:
        if self._passes is None:
            raise GraphicsError("the preview is closed: make a new one")
        return self._passes

    def _check(self, phi: Array, bends: Array) -> None:
        fibers = self.scene.lamp_count
        if phi.ndim != 2 or len(phi) != fibers:
            raise DesignError(
                f"phi has shape {phi.shape}, allowed: one row for each of {fibers} fibers",
                field="phi",
            )
        for name, values in (("phi", phi), ("bend", bends)):
            bad = ~((values >= 0) & (values <= np.pi))
            if bad.any():
                raise DesignError(
                    f"{name} = {np.degrees(values[bad].flat[0]):g} deg, allowed: 0 to 180 deg",
                    field=name,
                )

    def _radiosity_at(self, bend: float) -> Radiosity:
        """Return the radiosity at a bend, made when it is first asked for."""
        if bend not in self._radiosity:
            albedo = self._lights.edge_albedo
            self._radiosity[bend] = solve_radiosity(self.scene, self._points, bend, albedo)
        return self._radiosity[bend]

    def _blur_at(self, bend: float) -> Array:
        """Return `facet_blur` at a bend, made when it is first asked for; pictures need none."""
        if bend not in self._blurs:
            self._blurs[bend] = facet_blur(self.scene, bend)
        return self._blurs[bend]
