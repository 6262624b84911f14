"""The preview's two passes, transport cells and pictures, which share one shading function."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import (
    SHADOW_LENGTH,
    HeightMap,
    Imprint,
    camera_axes,
    camera_origin,
    curvature,
    half_view,
)
from render.preview.bonded import Bond
from render.preview.gl import create_context
from render.preview.light_paths import MIN_CURVATURE
from render.preview.lights import PointLights, with_images
from render.preview.shader import ShaderPass, float_texture, source
from render.preview.shading_points import ShadingPoints
from render.preview.skin_texels import skin_texels
from render.scene import EDGES, Coating, Scene

MAX_TARGET_SIDE = 8192
"""Largest side of a target: OpenGL 3.3 drivers offer at least this."""
POINT_COLUMNS = 1024
"""Points per row of their texture."""


class ShaderPasses:
    """The shader programs of one scene and what they read, in an OpenGL context of its own.

    ``imprint`` is pressed into its pictures: planes of bodies, or skin as a height map. ``bond`` is
    where a window of another index begins.
    """

    def __init__(
        self,
        scene: Scene,
        lights: PointLights,
        points: ShadingPoints,
        imprint: Imprint | HeightMap,
        backend: str | None,
        bond: Bond | None = None,
    ) -> None:
        """Open the context and upload what does not depend on the design."""
        self._scene, self._lights, self._imprint, self._bond = scene, lights, imprint, bond
        self._count = len(points.position)
        self._compiled: dict[tuple[str, bool, int, bool, bool], ShaderPass] = {}
        self._context: Any = create_context(backend)
        with self._context:
            self._parts = [points.position, points.normal]
            if scene.skin is not None:
                self._parts.append(points.below)
            self._points = self._point_texture(self._parts)
            self._fibers = float_texture(self._context, with_images(scene, lights.position))
            self._kept = {}
            if lights.profiles is not None:
                table = float_texture(self._context, lights.profiles[..., None], smooth=True)
                self._kept["profiles"] = table
            if isinstance(imprint, HeightMap):
                self._skin = float_texture(self._context, imprint.depth[..., None], smooth=True)
            if scene.skin is not None:
                for name, values in skin_texels(scene, imprint).items():
                    smooth = name != "site_frames"
                    self._kept[name] = float_texture(self._context, values, smooth=smooth)

    def release(self) -> None:
        """Free the OpenGL context."""
        self._context.release()

    def direct(
        self, emission: Array, bend: float, skin: Coating, sights: Array | None = None
    ) -> NDArray[np.float32]:
        """Draw direct irradiance of every fiber's lights, ``(fiber, node, point, 2)``.

        The second is that of the coating at the foot of the point's facet, without what comes
        from behind the facet: that is in the pyramid's shadow.

        ``emission`` is ``(fiber, node, light, n)``. With ``sights`` ``(point, 3)``, local
        directions to the camera, it is what would look as bright from there if ``skin`` had no
        lobe.
        """
        fibers, nodes = emission.shape[:2]
        rows = emission.reshape(fibers * nodes, -1, 4)
        with self._context:
            texture = float_texture(self._context, rows)
            drawn = self._at_points(
                bend, self._fibers, texture, fibers * nodes, 1, nodes, skin, sights
            )
            texture.release()
        return drawn.reshape(fibers, nodes, -1, 2)

    def merged(self, position: Array, emission: Array, bend: float) -> NDArray[np.float32]:
        """Draw direct irradiance of one list of lights at every point, ``(3, point)``.

        ``position`` is ``(1, light, 4)``, ``emission`` ``(3, light, n)``.
        """
        with self._context:
            lights = float_texture(self._context, with_images(self._scene, position))
            emissions = float_texture(self._context, emission.reshape(3, -1, 4))
            drawn = self._at_points(bend, lights, emissions, 1, 3, 1)
            lights.release()
            emissions.release()
        return np.ascontiguousarray(drawn[0].T)

    def picture(
        self,
        position: Array,
        emission: Array,
        coating: Array,
        facet: Array | None,
        bend: float,
        size: tuple[int, int],
        skin: Coating,
    ) -> NDArray[np.float32]:
        """Draw radiance at the camera ``(height, width, 3)``, row 0 at the tip.

        Arguments:
            position: one list of lights ``(1, light, 4)``.
            emission: theirs, ``(3, light, n)``.
            coating: indirect irradiance ``(3, row, column)`` over the pad.
            facet: indirect irradiance ``(3, site, facet)``, on a height map what its slopes add
                ``(3, 1, 5)`` (`slope_terms`), or None for the untouched pad.
            bend: rad.
            size: width and height in pixels.
            skin: what the coating is made of, of one albedo.
        """
        lights = with_images(self._scene, position)
        with self._context:
            images = {
                "lights": float_texture(self._context, lights),
                "emissions": float_texture(self._context, emission.reshape(3, -1, 4)),
                "indirect": float_texture(self._context, np.moveaxis(coating, 0, -1), smooth=True),
            }
            kept = dict(self._kept)
            if facet is not None:
                mapped = isinstance(self._imprint, HeightMap)
                name = "slope_indirect" if mapped else "facet_indirect"
                images[name] = float_texture(self._context, np.moveaxis(facet, 0, -1))
                kept |= {"height_map": self._skin} if mapped else {}
            uniforms = self._uniforms(bend, lights.shape[1]) | self._view(size)
            uniforms |= _reflecting(skin)
            lobe = skin.lobe is not None
            shader_pass = self._pass("picture.frag", bend, 3, facet is not None, lobe)
            picture = shader_pass.draw(size, 3, uniforms, images | kept)
            for image in images.values():
                image.release()
        return picture[::-1].copy()

    def _point_texture(self, parts: list[Array]) -> Any:
        """Return the texture of ``parts`` ``(point, 3)`` of the points, side by side."""
        texels = np.stack(parts, axis=1)
        short = -self._count % POINT_COLUMNS
        texels = np.pad(texels, ((0, short), (0, 0), (0, 0)), mode="edge")
        return float_texture(self._context, texels.reshape(-1, len(parts) * POINT_COLUMNS, 3))

    def _at_points(
        self, bend: float, lights: Any, emissions: Any, rows: int, channels: int, nodes: int,
        skin: Coating | None = None, sights: Array | None = None,
    ) -> NDArray[np.float32]:  # fmt: skip
        """Return ``(row, point, channel)``."""
        points = self._points if sights is None else self._point_texture([*self._parts, sights])
        images = {"points": points, "lights": lights, "emissions": emissions}
        images |= self._kept
        uniforms = self._uniforms(bend, lights.width) | {"nodes": nodes}
        uniforms |= {} if skin is None else _reflecting(skin)
        shader_pass = self._pass("transport.frag", bend, channels, False, sights is not None)
        parts = []
        for first in range(0, self._count, MAX_TARGET_SIDE):
            size = (min(MAX_TARGET_SIDE, self._count - first), rows)
            wanted = uniforms | {"first_point": first}
            parts.append(shader_pass.draw(size, 3 if channels == 3 else 2, wanted, images))
        if sights is not None:
            points.release()
        return np.concatenate(parts, axis=1)

    def _pass(
        self, fragment: str, bend: float, channels: int, indented: bool, lobe: bool
    ) -> ShaderPass:
        """Return the program specialized to what it has to draw."""
        key = (fragment, bend > 0, channels, indented, lobe)
        if key not in self._compiled:
            defines = dict(self._lights.defines)
            defines |= {"CHANNELS": str(channels), "POINT_COLUMNS": str(POINT_COLUMNS)}
            if bend > 0:
                defines["BENT"] = "1"
            if self._scene.skin is not None:
                defines["CURVED"] = "1"
            if lobe:
                defines["LOBE"] = "1"
            if any(finish.metal is not None for finish in self._scene.finishes):
                defines["METAL"] = "1"
            if fragment == "picture.frag" and self._scene.camera.fisheye:
                defines["FISHEYE"] = "1"
            parts = ["light_paths.glsl", "shading.glsl", fragment]
            if self._bond is not None:
                defines["BONDED"] = "1"
                parts.insert(2, "bonded.glsl")
            if indented and isinstance(self._imprint, HeightMap):
                defines["HEIGHT_MAP"] = "1"
                parts.insert(0, "height_map.glsl")
            elif indented and isinstance(self._imprint, Imprint):
                defines["FACES"] = str(len(self._imprint.normal))
            self._compiled[key] = ShaderPass(self._context, source(*parts, defines=defines))
        return self._compiled[key]

    def _uniforms(self, bend: float, lights: int) -> dict[str, Any]:
        pad, layer = self._scene.pad, self._scene.diffuser
        profile = self._scene.placed_lamps()[0].profile
        kappa = max(curvature(self._scene, bend), MIN_CURVATURE)
        bond = self._bond or Bond(0.0, pad.index)
        return {
            "bond": bond.height,
            "window_index": bond.window_index,
            "thickness": pad.thickness,
            "refractive_index": pad.index,
            "kappa": kappa,
            "radius": 1 / kappa,
            "light_count": lights,
            "inverse_width": 1 / (2 * (profile.sigma_v or 1.0)),
            "optical_thickness": [
                (layer.sigma_s + layer.sigma_a) * layer.thickness if layer and milky else 0.0
                for milky in self._scene.box.layered
            ],
            "box_low": tuple(self._scene.box.low),
            "box_high": tuple(self._scene.box.high),
            "clear_half": (pad.width / 2, pad.length / 2),
            "metal": [
                -1.0 if metal is None else metal
                for metal in (self._scene.finish(edge).metal for edge in EDGES)
            ],
            "profile_rows": 1.0 if self._lights.profiles is None else len(self._lights.profiles),
        }

    def _view(self, size: tuple[int, int]) -> dict[str, Any]:
        scene = self._scene
        right, down, ahead = camera_axes(scene)
        return self._pressed() | {
            "size": (float(size[0]), float(size[1])),
            "half_view": half_view(scene, *size),
            "camera": tuple(camera_origin(scene)),
            "leftward": tuple(-right),
            "upward": tuple(-down),
            "ahead": tuple(ahead),
            "pivot": scene.camera.pivot,
            "half_pad": (scene.pad.width / 2, scene.pad.length / 2),
        }

    def _pressed(self) -> dict[str, Any]:
        """Return the uniforms of what is pressed in."""
        pressed = self._imprint
        if isinstance(pressed, HeightMap):
            return {
                "map_half": (pressed.width / 2, pressed.length / 2),
                "map_step": pressed.step,
                "map_bounds": pressed.bounds,
                "deepest": pressed.deepest,
                "longest_shadow": SHADOW_LENGTH * pressed.size,
            }
        return {
            "site_first": tuple(pressed.center[0]),
            "site_step": (pressed.spacing, pressed.spacing),
            "site_count": (float(pressed.columns), float(pressed.rows)),
            "longest_shadow": SHADOW_LENGTH * pressed.size,
            "facet_planes": [
                (*n, d) for n, d in zip(pressed.normal, pressed.distance, strict=True)
            ],
        }


def _reflecting(skin: Coating) -> dict[str, float]:
    """Return the uniforms of a coating of one albedo."""
    specular, roughness = skin.lobe or (0.0, 1.0)
    return {
        "albedo": skin.reflectance,
        "lobe_share": specular / skin.reflectance if specular else 0.0,
        "lobe_roughness": roughness,
    }
