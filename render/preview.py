"""The preview, level 0: transport and pictures from one shader program, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.bending import Array, curvature
from render.errors import RenderError
from render.gl import create_context
from render.glow import make_lights
from render.interreflection import indirect_irradiance
from render.layout import facet_normals, flat_sites, pyramid
from render.pad_points import pad_points
from render.scene import Scene
from render.view import view_weights

LARGEST_BEND = np.pi


@dataclass(frozen=True)
class _Bent:
    """What one bend needs besides the shader: interreflection and the camera's view."""

    indirect: Array
    view: Array


class Preview:
    """Draws one scene on OpenGL; a context manager that frees the context.

    Radiance at the camera per unit fiber power, 1/(mm^2 sr): direct light of every fiber at every
    facet (straight and by way of the lower face), interreflection, and the camera's view. Nothing
    in it is fitted to the reference.

    Arguments:
        scene: the sensor; the shader is specialised to what it declares.
        backend: ``osmesa`` or ``egl``; None takes the first that works.
        cache: folder of cached slab responses.
    """

    def __init__(
        self, scene: Scene, *, backend: str | None = None, cache: Path | None = None
    ) -> None:
        """Open the context, upload the scene, compile the transport pass."""
        self.scene = scene
        self._lights = make_lights(scene, cache)
        self._points = pad_points(scene)
        self._bent: dict[float, _Bent] = {}
        self._programs: dict[tuple[str, bool, int, bool], Any] = {}
        self._context = create_context(backend)
        with self._context:
            position, normal = self._points.position, self._points.normal
            texels = np.stack([position, normal], axis=1).reshape(1, -1, 3)
            self._point_texture = self._texture(np.pad(texels, ((0, 0), (0, 0), (0, 1))))
            self._light_texture = self._texture(self._lights.position)

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
        """Free the OpenGL context; the preview cannot draw afterwards."""
        if self._context is not None:
            self._context.release()
            self._context = None

    def transport(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return T ``(fiber, node, bend, site, facet)`` and background ``(fiber, node, bend, site)``.

        Arguments:
            phi: ``(node,)`` rad, the same for all fibers, or ``(fiber, node)``.
            bends: ``(bend,)`` rad in [0, pi].
        """
        fibers = self.scene.fibers.count
        phi = np.broadcast_to(np.asarray(phi, dtype=np.float64), (fibers, np.shape(phi)[-1]))
        self._check(phi, bends)
        # Rows of the target are fiber-major: fiber * nodes + node.
        emission = self._lights.emission(phi.T).swapaxes(0, 1)
        emission = emission.reshape(fibers * phi.shape[1], *emission.shape[2:])
        facets, background = [], []
        for bend in bends:
            light = self._irradiance(emission, float(bend), phi.shape[1])
            seen = self._seen(light, float(bend)).reshape(*phi.shape, self._points.sites, -1)
            facets.append(seen[..., :-1])
            background.append(seen[..., -1])
        return np.stack(facets, axis=2), np.stack(background, axis=2)
