"""The preview: transport and pictures from one shading function, without a display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.arguments import as_folder, as_kind, as_numbers, as_one_of, as_whole, refuse
from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.errors import DesignError, GraphicsError
from render.geometry import (
    HeightMap,
    Imprint,
    SkinChart,
    counted_sites,
    declared_sites,
    in_state,
    pyramids,
)
from render.preview.bonded import bond_of, with_bonded_window
from render.preview.facet_blur import facet_blurs, lines_of_sight
from render.preview.gl import BACKENDS
from render.preview.lights import PointLights, point_lights
from render.preview.passes import MAX_TARGET_SIDE, Points, ShaderPasses
from render.preview.radiosity import Radiosity, form_factors, solve_radiosity
from render.preview.shading_points import shading_points
from render.preview.sight import Sight
from render.preview.sloped_skin import slope_terms, sloped_skin
from render.preview.superposition import LightTable, light_table
from render.scene import Coating, Scene, as_scene

KEPT_PIXELS = 2**20
"""Pixels of pictures whose sight is kept for the next design."""


@dataclass(frozen=True, eq=False)
class PictureView:
    """One picture as far as it does not depend on the design.

    Arguments:
        sight: what its pixels see.
        points: theirs.
        light: direct light there for each albedo; one for all unless the skin has a lobe.
    """

    sight: Sight
    points: Points
    light: list[LightTable]


class Preview:
    """Draws one scene with OpenGL; a context manager that frees the OpenGL context.

    Radiance at the camera in 1/(mm^2 sr) per unit power of a fiber: direct light of its glow at
    every facet (straight and by way of the lower face), radiosity, and the camera's view.
    Nothing in it is fitted to the reference.

    Arguments:
        scene: the sensor, its name or its file; the shader is specialized to what it declares. Each
            of its states has a context of its own.
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
        scene: Scene | str | Path,
        *,
        backend: str | None = None,
        cache: str | Path | None = None,
        lights: PointLights | None = None,
        imprint: Imprint | HeightMap | None = None,
    ) -> None:
        """Make the lights, open the context, upload what does not depend on the design."""
        scene = as_scene(scene)
        if backend is not None:
            as_one_of(backend, BACKENDS, "backend", GraphicsError)
        for name, given, kind in (("lights", lights, PointLights),
                                  ("imprint", imprint, Imprint | HeightMap)):  # fmt: skip
            as_kind(given, kind | None, name, "what render makes, or None", GraphicsError)
        self._whole = scene
        self._others: dict[float, Preview] = {}
        if scene.states is not None:
            if imprint is not None:
                raise GraphicsError(
                    f"{scene.name} has states, and what is pressed in stands on the skin of one: "
                    "make the preview of that (render.geometry.in_state)"
                )
            scene, _ = in_state(scene, 0.0)
        cache = as_folder(cache, "cache", GraphicsError)
        self._given: dict[str, Any] = {"backend": backend, "cache": cache, "lights": lights}
        # Lines of sight are those of the scene; light is in a pad that the window is part of.
        bond = bond_of(scene)
        self._seen_in = scene if bond is not None else with_bonded_window(scene)
        self.scene = scene = with_bonded_window(scene)
        self._lights = lights or point_lights(scene, cache, bond)
        pressed = imprint or pyramids(scene)
        self._measures = imprint is None
        self._counted = counted_sites(self._seen_in)
        self._skin = isinstance(pressed, HeightMap)
        self._faces = sloped_skin(scene, pressed) if isinstance(pressed, HeightMap) else pressed
        self._points = shading_points(scene, self._faces)
        self._of_channel = list(scene.albedo_of_channel)
        self._views: dict[tuple[float, tuple[int, int], bool], PictureView] = {}
        self._lit: dict[float, LightTable] = {}
        self._radiosity: dict[float, list[Radiosity]] = {}
        self._seen_points: dict[float, Points] = {}
        self._tables: dict[float, Array] = {}
        self._passes: ShaderPasses | None = ShaderPasses(
            scene, self._lights, self._points, pressed, backend, bond
        )

    def __repr__(self) -> str:
        """Return in one line what it draws."""
        state = "closed" if self._passes is None else "open"
        return f"<Preview, {state}, of {self._whole!r}>"

    def __enter__(self) -> Preview:
        """Return the preview itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the OpenGL context."""
        self.close()

    def _of(self, state: float) -> tuple[Preview, float]:
        """Return the preview of a state, made when it is first asked for, and its bend in rad."""
        if self._whole.states is None or state == 0.0:
            return self, state
        if state not in self._others:
            self._others[state] = Preview(in_state(self._whole, state)[0], **self._given)
        return self._others[state], 0.0

    def close(self) -> None:
        """Free the OpenGL context; nothing can be drawn afterwards."""
        for other in self._others.values():
            other.close()
        if self._passes is not None:
            self._passes.release()
            self._passes = None

    def transport(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return T and background, float64 (drawn in float32).

        Arguments:
            phi: ``(node,)`` rad, the same for all fibers, or ``(fiber, node)``.
            bends: ``(bend,)`` rad in [0, pi], or numbers of the scene's states.

        Returns:
            T ``(fiber, node, bend, site, facet)`` and background ``(fiber, node, bend, site)``;
            both with one more axis ``channel`` where the skin's albedo depends on it.
        """
        fibers = self.scene.lamp_count
        phi = as_numbers(phi, "phi", DesignError)
        if phi.ndim == 1:
            phi = np.tile(phi, (fibers, 1))
        phi, bends = self._checked(phi, bends)
        if not self._measures:
            raise GraphicsError("only the pyramids have transport: make a preview without imprint")
        each = (self._of(float(bend)) for bend in bends)
        seen = np.stack([preview._seen(phi, bend) for preview, bend in each], axis=2)
        return seen[:, :, :, :, :-1], seen[:, :, :, :, -1]

    def _seen(self, phi: Array, bend: float) -> Array:
        """Return T and, as last facet, the background, as `draw` does."""
        nodes = self._lights.nodes
        if nodes is None:
            size = max(1, MAX_TARGET_SIDE // len(phi))
            parts = range(0, phi.shape[1], size)
            return np.concatenate([self.draw(phi[:, i : i + size], bend) for i in parts], axis=1)
        if bend not in self._tables:
            self._tables[bend] = self.draw(np.tile(nodes, (len(phi), 1)), bend)
        # Emission is a polynomial in phi through its nodes, and radiance is linear in emission.
        weights = interpolation_weights(nodes, phi)
        return np.asarray(np.einsum("fjn,fnsk...->fjsk...", weights, self._tables[bend]))

    def skin(self, phi: Array, bends: Array) -> Array:
        """Return irradiance on the untouched coating, ``(fiber, node, bend, row, column)``.

        With one more axis ``channel`` where the skin's albedo depends on it.
        The middles of even cells of the pad, rows from the base and columns from -x. Unit: 1/mm^2
        per unit power of a fiber.

        Arguments:
            phi: ``(node,)`` rad.
            bends: ``(bend,)`` rad, or the number of one of the scene's states, whose skin moves
                through the cells.
        """
        nodes = as_numbers(phi, "phi", DesignError)
        if nodes.ndim != 1:
            raise DesignError(f"phi has shape {nodes.shape}, allowed: (node,)", field="phi")
        every = np.tile(nodes, (self.scene.lamp_count, 1))
        every, bends = self._checked(every, bends)
        if self._whole.states is not None and len(bends) > 1:
            raise GraphicsError(
                f"states of {self._whole.name} have cells of their own: ask for one state at a time"
            )
        each = (self._of(float(bend)) for bend in bends)
        return np.stack([preview._on_skin(every, bend) for preview, bend in each], axis=2)

    def _on_skin(self, phi: Array, bend: float) -> Array:
        """Return `skin` at one bend for ``phi`` ``(fiber, node)``."""
        points = self._points
        direct = self.direct_irradiance(phi, bend).reshape(phi.size, -1, 2)[..., 0]
        parts = []
        for radiosity in self._radiosity_at(bend):
            added = radiosity.added(direct)
            total = (direct[:, : points.first_edge] + added)[:, points.first_patch :]
            parts.append(total.reshape(*phi.shape, points.rows, points.columns))
        return self._by_channel(parts)

    def draw(self, phi: Array, bend: float) -> Array:
        """Draw all cells at one bend: ``(fiber, node, site, facet + 1)``, the last the background.

        ``phi`` is ``(fiber, node)`` rad. `transport` gives the same and draws only when it must.
        With one more axis ``channel`` where the skin's albedo depends on it.
        """
        drawn = self.direct_irradiance(phi, bend).reshape(phi.size, -1, 2)
        lit = zip(
            self.scene.one_albedo_scenes,
            self._radiosity_at(bend),
            facet_blurs(self._seen_in, bend, 1),
            strict=True,
        )
        cells = [
            self._cells(drawn, self._of_lobe(scene.coating, phi, bend, drawn), radiosity, blur)
            for scene, radiosity, blur in lit
        ]
        shape = (*phi.shape, len(self._counted), -1)
        return self._by_channel([part.reshape(shape) for part in cells])

    def _of_lobe(self, coating: Coating, phi: Array, bend: float, drawn: Array) -> Array | None:
        """Return what a lobe makes of direct light, as irradiance ``(row, point, 2)``.

        Between faces it counts as diffuse.
        """
        if coating.lobe is None:
            return None
        emission = self._lights.emission(phi.T).swapaxes(0, 1)
        points = replace(self._points_seen_at(bend), coating=coating)
        seen = self._open.direct(emission, bend, points)
        return np.asarray(seen.astype(np.float64).reshape(drawn.shape) - drawn)

    def _cells(
        self, drawn: Array, lobe: Array | None, radiosity: Radiosity, weights: Array
    ) -> Array:
        """Return the cells ``(row, site, facet + 1)`` of direct irradiance ``(row, point, 2)``.

        ``lobe`` is added to it for the camera alone.
        """
        points = self._points
        direct, foot = drawn[..., 0], drawn[..., 1]
        total = direct[:, : points.first_edge] + radiosity.added(direct)
        shape = (len(drawn), points.sites, points.facets)
        facets = slice(0, points.sites * points.facets)
        site = total[:, facets.stop : points.first_patch, None]
        # At the foot of a facet the pyramid's shadow leaves what the site gets indirectly.
        shadow = site - direct[:, facets.stop : points.first_patch, None]
        around = foot[:, facets].reshape(shape) + shadow
        facet = total[:, facets].reshape(shape) + radiosity.below(around)
        if lobe is not None:
            facet = facet + lobe[:, facets, 0].reshape(shape)
            around = around + lobe[:, facets, 1].reshape(shape)
            site = site + lobe[:, facets.stop : points.first_patch, :1]
        facet, around, site = (part[:, self._counted] for part in (facet, around, site))
        sent = np.concatenate([facet, around, site], axis=-1)
        seen = np.einsum("sij,rsj->rsi", weights[:, :-1], sent)
        background = weights[:, -1, -1:] * site
        return np.concatenate([seen, background], axis=-1)

    def _by_channel(self, parts: list[Array]) -> Array:
        """Return what each albedo gives ``(...)`` by channel ``(..., channel)``, if they differ."""
        if len(parts) == 1:
            return parts[0]
        return np.stack([parts[albedo] for albedo in self._of_channel], axis=-1)

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
            bend: rad in [0, pi], or the number of one of the scene's states.
            width: columns of pixels.
            height: rows of pixels, over which the camera's field of view spreads.
            indented: pressed by the imprint, or untouched.

        x runs to the right and the tip is up; what is not pad is 0.
        """
        phi, power = as_numbers(phi, "phi", DesignError), as_numbers(power, "power", DesignError)
        self._checked(phi[..., None], [bend])
        _check_size(width, height)
        channels = len(self.scene.palette.channels)
        if power.shape != (len(phi), channels) or not np.isfinite(power).all():
            raise DesignError(
                f"power has shape {power.shape}, allowed: finite numbers, ({len(phi)}, {channels})",
                field="power",
            )
        one, bend = self._of(bend)
        if one is not self:
            return one.picture(phi, power, bend, width, height, indented)
        picture = np.empty((height, width, channels), dtype=np.float32)
        for albedo in range(len(self.scene.albedos)):
            alike = [c for c, seen in enumerate(self._of_channel) if seen == albedo]
            # Pictures of three channels each, the last ones dark where there are fewer.
            for first in range(0, len(alike), 3):
                chosen = alike[first : first + 3]
                three = np.pad(power[:, chosen], [(0, 0), (0, 3 - len(chosen))])
                drawn = self._picture(phi, three, bend, (width, height), indented, albedo)
                picture[..., chosen] = drawn[..., : len(chosen)]
        return picture

    def sight(self, bend: float, width: int, height: int, indented: bool = True) -> Sight:
        """Return which places of the skin the pixels of `picture` see, whatever the light."""
        self._checked(np.zeros((self.scene.lamp_count, 1)), [bend])
        _check_size(width, height)
        one, bend = self._of(bend)
        return one._view(bend, (width, height), indented).sight

    def _picture(
        self,
        phi: Array,
        power: Array,
        bend: float,
        size: tuple[int, int],
        indented: bool,
        albedo: int,
    ) -> NDArray[np.float32]:
        """Return three channels of a picture, ``power`` ``(fiber, 3)``, by one of the albedos."""
        view, points = self._view(bend, size, indented), self._points
        if bend not in self._lit:
            self._lit[bend] = self._table(self._open.points, bend)
        direct, light = (each.of(phi, power) for each in (self._lit[bend], view.light[albedo]))
        radiosity, sight = self._radiosity_at(bend)[albedo], view.sight
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
        return sight.picture(light + added, self.scene.one_albedo_scenes[albedo].coating)

    def _view(self, bend: float, size: tuple[int, int], indented: bool) -> PictureView:
        """Return what a picture sees, drawn when it is first asked for; the last few are kept."""
        key, passes = (bend, size, indented), self._open
        if key not in self._views:
            while (
                self._views
                and sum(len(view.sight.pixel) for view in self._views.values()) + size[0] * size[1]
                > KEPT_PIXELS
            ):
                passes.forget(self._views.pop(next(iter(self._views))).points)
            sight = passes.sight(bend, size, indented)
            pixels = passes.pixels_of(sight, indented)
            skins = [scene.coating for scene in self.scene.one_albedo_scenes]
            if self.scene.coating.lobe is None:
                light = [self._table(pixels, bend)] * len(skins)
            else:
                light = [self._table(replace(pixels, coating=skin), bend) for skin in skins]
            self._views[key] = PictureView(sight, pixels, light)
        return self._views[key]

    def _table(self, points: Points, bend: float) -> LightTable:
        return light_table(self.scene, self._open, self._lights, points, bend)

    @property
    def _open(self) -> ShaderPasses:
        if self._passes is None:
            raise GraphicsError("the preview is closed: make a new one")
        return self._passes

    def _checked(self, phi: Array, bends: Array | Sequence[float]) -> tuple[Array, Array]:
        """Return ``phi`` ``(fiber, node)`` and ``bends`` ``(bend,)`` as this scene has them."""
        fibers, found = self.scene.lamp_count, as_numbers(bends, "bend", DesignError)
        if phi.ndim != 2 or len(phi) != fibers or not phi.size:
            raise DesignError(
                f"phi has shape {phi.shape}, allowed: one row for each of {fibers} fibers",
                field="phi",
            )
        if found.ndim != 1 or not found.size:
            raise DesignError(f"bends have shape {found.shape}, allowed: (bend,)", field="bend")
        angles = found
        if self._whole.states is not None:
            for state in set(found.tolist()) - set(self._whole.state_axis):
                self._whole.in_state(state)  # says what there is
            angles = np.zeros(1)
        for name, values in (("phi", phi), ("bend", angles)):
            bad = ~((values >= 0) & (values <= np.pi))
            if bad.any():
                raise DesignError(
                    f"{name} = {np.degrees(values[bad].flat[0]):g} deg, allowed: 0 to 180 deg",
                    field=name,
                )
        return phi, found

    def _radiosity_at(self, bend: float) -> list[Radiosity]:
        """Return the radiosity at a bend for each albedo, made when it is first asked for."""
        if bend not in self._radiosity:
            points, edges = self._points, self._lights.edge_albedo
            factors = form_factors(self.scene, points, bend)
            self._radiosity[bend] = [
                solve_radiosity(scene, points, bend, edges, factors)
                for scene in self.scene.one_albedo_scenes
            ]
        return self._radiosity[bend]

    def _points_seen_at(self, bend: float) -> Points:
        """Return the points with what they see of the camera at a bend, made when first asked for.

        Sites that do not count, and patches, are looked at head-on.
        """
        if bend not in self._seen_points:
            points, faces = self._points, self._points.facets
            mean = -lines_of_sight(self._seen_in, bend).mean(axis=2)
            mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
            if self.scene.skin is None:
                places = declared_sites(self.scene)[self._counted, :2]
                mean = mean @ SkinChart(self.scene, bend).frames(places)
            sights = points.below * 1.0
            facet = sights[: points.sites * faces].reshape(points.sites, faces, 3)
            facet[self._counted] = mean[:, :faces]
            sights[points.sites * faces : points.first_patch][self._counted] = mean[:, -1]
            self._seen_points[bend] = self._open.seen_from(sights)
        return self._seen_points[bend]


def _check_size(width: int, height: int) -> None:
    for name, value in (("width", width), ("height", height)):
        if as_whole(value, name, GraphicsError, least=1) > MAX_TARGET_SIDE:
            refuse(value, name, f"1 to {MAX_TARGET_SIDE} pixels", GraphicsError)
