"""The preview, level 0: transport and pictures from one shading function, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.bending import Array, curvature
from render.chebyshev import interpolation_weights
from render.errors import DesignError, GraphicsError
from render.gl import create_context
from render.glow import make_lights
from render.interreflection import total_irradiance
from render.light_paths import LEAST_CURVATURE
from render.layout import facet_normals, flat_sites, pyramid
from render.pad_points import pad_points
from render.scene import Scene
from render.shader import Pass, float_texture, source
from render.view import view_weights


@dataclass(frozen=True)
class _Bent:
    """What follows the shader at one bend, linear in the direct irradiance ``(point,)``.

    irradiance: ``(target, point)``, total irradiance on facets, sites and coating patches.
    radiance: ``(site * (facet + 1), point)``, at the camera.
    """

    irradiance: Array
    radiance: Array


class Preview:
    """Draws one scene with OpenGL; a context manager that frees the OpenGL context.

    Radiance at the camera in 1/(mm^2 sr) per unit power of a fiber: direct light of its glow at
    every facet (straight and by way of the lower face), interreflection, and the camera's view.
    Nothing in it is fitted to the reference.

    Arguments:
        scene: the sensor; the shader is specialised to what it declares.
        backend: ``osmesa`` or ``egl``; None takes the first that works.
        cache: folder of cached slab responses; None is the user's cache.

    Example::

        with Preview(load_scene("finger20")) as preview:
            T, background = preview.transport(phi=np.array([np.pi / 2]), bends=np.array([0.0]))
    """

    def __init__(
        self, scene: Scene, *, backend: str | None = None, cache: Path | None = None
    ) -> None:
        """Make the lights, open the context, upload what does not depend on the design."""
        self.scene = scene
        self._lights = make_lights(scene, cache)
        self._points = pad_points(scene)
        self._bent: dict[float, _Bent] = {}
        self._tables: dict[float, Array] = {}
        self._passes: dict[tuple[str, ...], Pass] = {}
        self._context: Any = create_context(backend)
        with self._context:
            points = np.stack([self._points.position, self._points.normal], axis=1)
            self._point_texture = float_texture(self._context, points.reshape(1, -1, 3))
            self._light_texture = float_texture(self._context, self._lights.position)

    def __enter__(self) -> Preview:
        """Return the preview itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free the OpenGL context."""
        self.close()

    def close(self) -> None:
        """Free the OpenGL context; nothing can be drawn afterwards."""
        if self._context is not None:
            self._context.release()
            self._context = None

    def transport(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return T and background, float64 (drawn in float32).

        Arguments:
            phi: ``(node,)`` rad, the same for all fibers, or ``(fiber, node)``.
            bends: ``(bend,)`` rad in [0, pi].

        Returns:
            T ``(fiber, node, bend, site, facet)`` and background ``(fiber, node, bend, site)``.
        """
        fibers = self.scene.fibers.count
        phi = np.asarray(phi, dtype=np.float64)
        phi = np.broadcast_to(phi, (fibers, phi.shape[-1]))
        self._check(phi, np.asarray(bends))
        seen = np.stack([self._seen(phi, float(bend)) for bend in bends], axis=2)
        return seen[..., :-1], seen[..., -1]

    def _seen(self, phi: Array, bend: float) -> Array:
        """Return T and, as last facet, the background: ``(fiber, node, site, facet + 1)``."""
        nodes = self._lights.nodes
        if nodes is None:
            return self.draw(phi, bend)
        if bend not in self._tables:
            self._tables[bend] = self.draw(np.tile(nodes, (len(phi), 1)), bend)
        # Emission is a polynomial in phi through its nodes, and radiance is linear in emission.
        return np.einsum("fjn,fnsk->fjsk", interpolation_weights(nodes, phi), self._tables[bend])

    def draw(self, phi: Array, bend: float) -> Array:
        """Draw all cells at one bend: ``(fiber, node, site, facet + 1)``, the last the background.

        ``phi`` is ``(fiber, node)`` rad. `transport` gives the same and draws only when it must.
        """
        # Rows of the target are fiber-major: fiber * nodes + node.
        emission = self._lights.emission(phi.T).swapaxes(0, 1).reshape(phi.size, -1, 4)
        with self._context:
            texture = float_texture(self._context, emission)
            direct = self._point_pass(
                bend, phi.size, 1, {"nodes": phi.shape[1]}, self._light_texture, texture
            )
            texture.release()
        seen = direct[..., 0].astype(np.float64) @ self._at(bend).radiance.T
        return seen.reshape(*phi.shape, self._points.sites, -1)

    def picture(
        self,
        phi: Array,
        power: Array,
        bend: float,
        width: int,
        height: int,
        indented: bool = True,
    ) -> NDArray[np.float32]:
        """Return linear radiance ``(height, width, 3)`` of the pad as the camera sees it.

        Arguments:
            phi: ``(fiber,)`` rad.
            power: ``(fiber, 3)`` in [0, 1].
            bend: rad in [0, pi].
            width, height: pixels; the camera's field of view spans the height.
            indented: pressed by the pyramids, or untouched.

        x runs to the right and the tip is up; what is not pad is 0.
        """
        phi, power = np.asarray(phi, dtype=np.float64), np.asarray(power, dtype=np.float64)
        self._check(phi[:, None], np.array([bend]))
        position, emission = self._lights.merged(phi, power)
        with self._context:
            lights = float_texture(self._context, position)
            emissions = float_texture(self._context, emission.reshape(3, -1, 4))
            direct = self._point_pass(bend, 1, 3, {"nodes": 1}, lights, emissions)[0].T
            indirect = direct @ self._at(bend).irradiance.T - direct[:, : self._points.first_edge]
            points = self._points
            coating = indirect[:, points.first_patch :].reshape(3, points.rows, points.columns)
            facet = indirect[:, : points.sites * points.facets]
            facet = facet.reshape(3, points.sites, points.facets)
            textures = {
                "lights": lights,
                "emissions": emissions,
                "indirect": float_texture(
                    self._context, np.moveaxis(coating, 0, -1), smooth=True
                ),
                "facet_indirect": float_texture(self._context, np.moveaxis(facet, 0, -1)),
            }
            uniforms = self._uniforms(bend, position.shape[1]) | self._view_uniforms(width, height)
            picture = self._pass("picture.frag", bend, 3, indented).draw(
                (width, height), 3, uniforms, textures
            )
            for texture in textures.values():
                texture.release()
        return picture[::-1].copy()

    def _check(self, phi: Array, bends: Array) -> None:
        if self._context is None:
            raise GraphicsError("the preview is closed: make a new one")
        fibers = self.scene.fibers.count
        if phi.shape[0] != fibers:
            raise DesignError(
                f"phi has {phi.shape[0]} fibers, allowed: {fibers}", field="phi", value=phi.shape
            )
        for name, values in (("phi", phi), ("bend", bends)):
            bad = ~((values >= 0) & (values <= np.pi))
            if bad.any():
                raise DesignError(
                    f"{name} = {np.degrees(values[bad].flat[0]):g} deg, allowed: 0 to 180 deg",
                    field=name,
                    value=float(values[bad].flat[0]),
                    allowed="0 to 180 deg",
                )

    def _at(self, bend: float) -> _Bent:
        """Return what the bend needs, made when it is first asked for."""
        if bend not in self._bent:
            irradiance = total_irradiance(self.scene, self._points, bend, self._lights.edge_albedo)
            sites, facets = self._points.sites, self._points.facets
            # Facets and their site, side by side as in the view's columns.
            facet = irradiance[: sites * facets].reshape(sites, facets, -1)
            site = irradiance[sites * facets : sites * (facets + 1), None]
            view = view_weights(self.scene, bend)
            radiance = view @ np.concatenate([facet, site.reshape(sites, 1, -1)], axis=1)
            self._bent[bend] = _Bent(irradiance, radiance.reshape(-1, irradiance.shape[1]))
        return self._bent[bend]

    def _point_pass(
        self,
        bend: float,
        rows: int,
        channels: int,
        extra: dict[str, Any],
        lights: Any,
        emissions: Any,
    ) -> NDArray[np.float32]:
        """Return direct irradiance at all points of the pad, ``(row, point, channel)``."""
        textures = {"points": self._point_texture, "lights": lights, "emissions": emissions}
        return self._pass("transport.frag", bend, channels, False).draw(
            (len(self._points.position), rows),
            channels,
            self._uniforms(bend, lights.width) | extra,
            textures,
        )

    def _pass(self, fragment: str, bend: float, channels: int, indented: bool) -> Pass:
        """Return the pass specialised to what it has to draw."""
        defines = dict(self._lights.defines) | {"CHANNELS": str(channels)}
        if bend > 0:
            defines["BENT"] = "1"
        if indented:
            defines["FACES"] = str(self.scene.indenter.faces)
        key = (fragment, *sorted(defines))
        key = (*key, str(channels))
        if key not in self._passes:
            parts = ("light_paths.glsl", "shading.glsl", fragment)
            self._passes[key] = Pass(self._context, source(*parts, defines=defines))
        return self._passes[key]

    def _uniforms(self, bend: float, lights: int) -> dict[str, Any]:
        pad, fibers = self.scene.pad, self.scene.fibers
        kappa = max(curvature(self.scene, bend), LEAST_CURVATURE)
        return {
            "thickness": pad.thickness,
            "refractive_index": pad.index,
            "kappa": kappa,
            "radius": 1 / kappa,
            "light_count": lights,
            "inverse_width": 1 / (2 * fibers.sigma_v),
        }

    def _view_uniforms(self, width: int, height: int) -> dict[str, Any]:
        scene = self.scene
        tangent = float(np.tan(scene.camera.field_of_view / 2))
        site = flat_sites(scene)[0]
        normals, corners = facet_normals(scene), pyramid(scene)
        distance = np.einsum("ki,ki->k", normals, corners[:, 0])
        return {
            "size": (float(width), float(height)),
            "tangent": (tangent * width / height, tangent),
            "camera": (0.0, scene.camera.y, -scene.camera.distance),
            "half_pad": (scene.pad.width / 2, scene.pad.length / 2),
            "albedo": scene.coating.albedo,
            "site_first": tuple(site),
            "site_step": (scene.sites.spacing, scene.sites.spacing),
            "site_count": (float(scene.sites.columns), float(scene.sites.rows)),
            "facet_planes": [(*n, d) for n, d in zip(normals, distance, strict=True)],
        }
