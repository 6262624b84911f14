"""The preview's passes: direct light at points, and the points that the pixels of a picture see."""

from __future__ import annotations

from dataclasses import dataclass
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
from render.preview.sight import Sight
from render.preview.skin_texels import skin_texels
from render.scene import EDGES, Coating, Scene

MAX_TARGET_SIDE = 8192
"""Largest side of a target: OpenGL 3.3 drivers offer at least this."""
POINT_COLUMNS = 1024
"""Points per row of their texture."""
BLOCK_ROWS, BLOCK_STEP = 16, 64
"""Drivers draw in squares: so many rows of points for each list of lights, and columns in steps."""
MAX_TARGET_CELLS = 2**22
"""Cells that are drawn at a time, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points at which light is drawn, on the driver.

    Arguments:
        texture: ``texels`` for each, `POINT_COLUMNS` points per row.
        count: of points.
        texels: per point.
        pixels: whether they are what pixels see, which shadows fall on.
        indented: whether bodies are pressed in among them.
        coating: whose lobe sends light from them to the camera: then what is drawn is the
            irradiance that would look as bright if it had none. None: irradiance.
    """

    texture: Any
    count: int
    texels: int
    pixels: bool = False
    indented: bool = False
    coating: Coating | None = None


class ShaderPasses:
    """The shader programs of one scene and what they read, in an OpenGL context of its own.

    ``imprint`` is pressed into its pictures: planes of bodies, or skin as a height map. ``points``
    are those of the scene. ``bond`` is where a window of another index begins.
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
        self._compiled: dict[tuple[str, bool, int, bool, bool, bool, int], ShaderPass] = {}
        self._context: Any = create_context(backend)
        with self._context:
            self._parts = [points.position, points.normal]
            if scene.skin is not None:
                self._parts.append(points.below)
            self.points = self._point_set(np.stack(self._parts, axis=1))
            self._fibers = float_texture(self._context, with_images(scene, lights.position))
            self._kept = {}
            if lights.profiles is not None:
                table = float_texture(self._context, lights.profiles[..., None], smooth=True)
                self._kept["profiles"] = table
            if isinstance(imprint, HeightMap):
                depth = float_texture(self._context, imprint.depth[..., None], smooth=True)
                self._kept["height_map"] = depth
            if scene.skin is not None:
                for name, values in skin_texels(scene, imprint).items():
                    smooth = name != "site_frames"
                    self._kept[name] = float_texture(self._context, values, smooth=smooth)

    def release(self) -> None:
        """Free the OpenGL context."""
        self._context.release()

    def direct(
        self, emission: Array, bend: float, points: Points | None = None
    ) -> NDArray[np.float32]:
        """Draw direct irradiance of every fiber's lights, ``(fiber, node, point, 2)``.

        The second is that of the coating at the foot of the point's facet, without what comes
        from behind the facet: that is in the pyramid's shadow.

        ``emission`` is ``(fiber, node, light, n)``; ``points`` are those of the scene, or others
        (`pixels_of`, `seen_from`).
        """
        fibers, nodes = emission.shape[:2]
        rows = emission.reshape(fibers * nodes, -1, 4)
        with self._context:
            texture = float_texture(self._context, rows)
            drawn = self._at_points(
                points or self.points, bend, self._fibers, texture, (fibers * nodes, 1, nodes)
            )
            texture.release()
        return drawn.reshape(fibers, nodes, -1, 2)

    def lists(
        self, position: Array, emission: Array, bend: float, points: Points
    ) -> NDArray[np.float32]:
        """Draw direct irradiance of lists of lights in three channels, ``(list * 3, point)``.

        ``position`` is ``(list, light, 4)``, ``emission`` ``(list * 3, light, n)``.
        """
        with self._context:
            lights = float_texture(self._context, with_images(self._scene, position))
            emissions = float_texture(self._context, emission.reshape(len(emission), -1, 4))
            drawn = self._at_points(points, bend, lights, emissions, (len(position), 3, 1))
            lights.release()
            emissions.release()
        return np.ascontiguousarray(drawn.swapaxes(1, 2)).reshape(len(emission), -1)

    def sight(self, bend: float, size: tuple[int, int], indented: bool) -> Sight:
        """Return what the pixels of a picture see of the pad, pressed by the imprint or not."""
        lobe = self._scene.coating.lobe is not None
        uniforms = self._uniforms(bend, 0) | self._view(size)
        with self._context:
            shader_pass = self._pass("sight.frag", bend, 0, indented, lobe=lobe)
            drawn = [
                shader_pass.draw(size, 4, uniforms | {"part": part}, self._kept).reshape(-1, 4)
                for part in range(4 if lobe else 3)
            ]
        (pixel,) = np.nonzero(drawn[0][:, 3] > 0.0)
        place, facing, body, *rest = (part[pixel].astype(np.float64) for part in drawn)
        facet, site = (np.rint(part[:, 3]).astype(np.int64) for part in (facing, body))
        return Sight(
            scene=self._scene,
            size=size,
            pixel=pixel.astype(np.int64),
            position=place[:, :3],
            facing=facing[:, :3],
            passed=place[:, 3],
            facet=facet,
            site=site,
            from_body=body[:, :3],
            to_camera=rest[0][:, :3] if rest else None,
        )

    def pixels_of(self, sight: Sight, indented: bool) -> Points:
        """Upload the points of a picture; `forget` frees them."""
        shaded = np.where(sight.facet < 0, sight.site, -1)[:, None]
        body = np.concatenate([sight.from_body, shaded], axis=1)
        ways = [] if sight.to_camera is None else [sight.to_camera]
        place, facing, *rest = (
            np.pad(part, [(0, 0), (0, 1)]) for part in (sight.position, sight.facing, *ways)
        )
        with self._context:
            return self._point_set(np.stack([place, facing, body, *rest], axis=1), True, indented)

    def seen_from(self, to_camera: Array) -> Points:
        """Upload the points of the scene with unit directions to the camera, ``(point, 3)``."""
        with self._context:
            return self._point_set(np.stack([*self._parts, to_camera], axis=1))

    def forget(self, points: Points) -> None:
        """Free points that are not drawn any more."""
        with self._context:
            points.texture.release()

    def _point_set(self, texels: Array, pixels: bool = False, indented: bool = False) -> Points:
        """Upload points ``(point, texel, component)``; there may be none."""
        count, each, components = texels.shape
        rows = max(-(-count // POINT_COLUMNS), 1)
        padded = np.zeros((rows * POINT_COLUMNS, each, components))
        padded[:count] = texels
        texture = float_texture(self._context, padded.reshape(rows, -1, components))
        return Points(texture, count, each, pixels, indented)

    def _at_points(
        self,
        points: Points,
        bend: float,
        lights: Any,
        emissions: Any,
        lists: tuple[int, int, int],
    ) -> NDArray[np.float32]:
        """Return ``(row, point, channel)``; ``lists`` are rows, channels and nodes."""
        rows, channels, nodes = lists
        if not points.count:
            return np.zeros((rows, 0, 3 if channels == 3 else 2), dtype=np.float32)
        images = {"points": points.texture, "lights": lights, "emissions": emissions}
        images |= self._kept
        uniforms = self._uniforms(bend, lights.width) | self._pressed() | {"nodes": nodes}
        uniforms |= _lobe(points.coating)
        shader_pass = self._pass(
            "transport.frag",
            bend,
            channels,
            points.indented,
            pixels=points.pixels,
            lobe=points.coating is not None,
            texels=points.texels,
        )
        columns = -(-points.count // (BLOCK_ROWS * BLOCK_STEP)) * BLOCK_STEP
        columns = min(columns, POINT_COLUMNS)
        most = min(MAX_TARGET_SIDE, MAX_TARGET_CELLS // columns)
        high = min(-(-points.count // columns), max(1, most // rows))
        parts = []
        for first in range(0, points.count, columns * high):
            wanted = uniforms | {
                "first_point": first,
                "last_point": points.count - 1,
                "block": (columns, high),
            }
            size = (columns, rows * high)
            drawn = shader_pass.draw(size, 3 if channels == 3 else 2, wanted, images)
            parts.append(drawn.reshape(rows, columns * high, -1)[:, : points.count - first])
        return np.concatenate(parts, axis=1)

    def _pass(
        self,
        fragment: str,
        bend: float,
        channels: int,
        indented: bool,
        *,
        pixels: bool = False,
        lobe: bool = False,
        texels: int = 0,
    ) -> ShaderPass:
        """Return the program specialized to what it has to draw."""
        key = (fragment, bend > 0, channels, indented, pixels, lobe, texels)
        if key not in self._compiled:
            shades = fragment == "transport.frag"
            defines = dict(self._lights.defines)
            if shades:
                defines |= {"CHANNELS": str(channels), "POINT_COLUMNS": str(POINT_COLUMNS)}
                defines |= {"POINT_TEXELS": str(texels)} | ({"PIXELS": "1"} if pixels else {})
            else:
                defines = {"SOFT_RADIUS": defines["SOFT_RADIUS"]}
            if bend > 0:
                defines["BENT"] = "1"
            parts = ["light_paths.glsl"]
            if self._scene.skin is not None:
                defines["CURVED"] = "1"
                parts.append("skin.glsl")
            if lobe:
                defines["LOBE"] = "1"
            if self._bond is not None:
                defines["BONDED"] = "1"
            if shades and any(finish.metal is not None for finish in self._scene.finishes):
                defines["METAL"] = "1"
            if not shades and self._scene.camera.fisheye:
                defines["FISHEYE"] = "1"
            if indented and isinstance(self._imprint, HeightMap):
                defines["HEIGHT_MAP"] = "1"
                parts.append("height_map.glsl")
            elif indented and isinstance(self._imprint, Imprint):
                defines["FACES"] = str(len(self._imprint.normal))
                if self._scene.sites.carried is not None and len(self._imprint.center) > 1:
                    defines["CARRIED"] = "1"
                parts.append("pyramid.glsl")
            parts.append("shading.glsl" if shades else "sight.glsl")
            if shades and self._bond is not None:
                parts.append("bonded.glsl")
            parts.append(fragment)
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
            "half_pad": (pad.width / 2, pad.length / 2),
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
            # Its corners, of an edge too, are less than sqrt(2) of its size away.
            "body_reach": 1.5 * pressed.size,
            "facet_planes": [
                (*n, d) for n, d in zip(pressed.normal, pressed.distance, strict=True)
            ],
        }


def _lobe(coating: Coating | None) -> dict[str, float]:
    """Return the uniforms of the lobe of a coating of one albedo."""
    if coating is None or coating.lobe is None:
        return {}
    specular, roughness = coating.lobe
    return {"lobe_share": specular / coating.reflectance, "lobe_roughness": roughness}
