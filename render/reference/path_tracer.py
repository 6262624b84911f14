"""Mitsuba's own path tracer on whole designs: what the ladder costs without our renderer."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.geometry import FacetMasks, counted_sites, facet_masks, in_state
from render.reference.llvm import mitsuba
from render.scene import Scene

VARIANT = "llvm_ad_rgb"
MAX_PATHS = 2**21
"""Paths at once, at about 200 byte each; more samples than that are taken in passes."""


class PathTracer:
    """Mitsuba's ``volpath`` at the scene's bends.

    Only the part of the film that shows facets is rendered.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.states = [in_state(scene, state) for state in scene.state_axis]
        self.masks = [facet_masks(*state) for state in self.states]

    def radiance(self, phi: Array, power: Array, spp: int, seed: int) -> Array:
        """Return radiance ``(bend, site, facet, channel)`` of one design; ``spp`` is per pixel.

        Three channels are traced at once, as colors of the picture.
        """
        channels = power.shape[1]
        padded = np.pad(power, [(0, 0), (0, -channels % 3)])
        parts = [
            self._radiance(phi, padded[:, first : first + 3], spp, seed)
            for first in range(0, channels, 3)
        ]
        return np.concatenate(parts, axis=-1)[..., :channels]

    def _radiance(self, phi: Array, power: Array, spp: int, seed: int) -> Array:
        """Return radiance of three channels, ``power`` ``(fiber, 3)``."""
        mi = mitsuba(VARIANT)
        _register_tinted_fiber()
        radiance = []
        for number, ((sensor, bend), masks) in enumerate(zip(self.states, self.masks, strict=True)):
            scene, crop = _lit(mi, sensor, phi, power, bend, masks)
            film = np.full((masks.rows, masks.columns, 3), np.nan)
            film[crop] = _traced(mi, scene, film[crop][..., 0].size, spp, (seed, number))
            pixels = film.reshape(-1, 3)
            sites, facets = counted_sites(self.scene), range(masks.facets)
            radiance.append([[pixels[masks.of(s, f)].mean(axis=0) for f in facets] for s in sites])
        return np.array(radiance)


def _lit(
    mi: Any, scene: Scene, phi: Array, power: Array, bend: float, masks: FacetMasks
) -> tuple[Any, tuple[slice, slice]]:
    """Return the lit Mitsuba scene with its sensor, and the part of the film it records."""
    from render.optics.lit_scene import camera_sensor, fiber_disks
    from render.optics.pad_scene import pad_shapes

    row, column = masks.pixel // masks.columns, masks.pixel % masks.columns
    top, left = int(row.min()), int(column.min())
    height, width = int(row.max()) + 1 - top, int(column.max()) + 1 - left
    lamps = scene.placed_lamps()
    if any(lamp.profile.sigma_v is None for lamp in lamps):
        raise RenderError(
            "a lamp's profile is not Gaussian, which this path tracer cannot draw: leave "
            "Mitsuba's own levels out",
            field="profile",
        )
    emitters = {
        fiber: {
            "type": "tinted_fiber",
            "sigma_v": float(np.degrees(lamp.profile.sigma_v or 0.0)),
            **dict(zip(("red", "green", "blue"), color.tolist(), strict=True)),
        }
        for fiber, (lamp, color) in enumerate(zip(lamps, power, strict=True))
    }
    sensor = camera_sensor(
        scene,
        masks.columns,
        masks.rows,
        crop_offset_x=left,
        crop_offset_y=top,
        crop_width=width,
        crop_height=height,
        pixel_format="rgb",
    )
    disks = fiber_disks(scene, phi, bend, emitters)
    with tempfile.TemporaryDirectory(prefix="tactilux-") as folder:
        pad = pad_shapes(scene, bend, True, Path(folder))
        content = {"type": "scene", "sensor": sensor, **disks, **pad}
        crop = (slice(top, top + height), slice(left, left + width))
        return mi.load_dict(content, optimize=False), crop


def _traced(mi: Any, scene: Any, pixels: int, spp: int, seed: tuple[int, int]) -> Array:
    """Return the picture ``(row, column, 3)`` of ``spp`` samples in each of its ``pixels``."""
    integrator = mi.load_dict({"type": "volpath"})
    passes = -(-spp * pixels // MAX_PATHS)
    whole: Array = np.zeros(())
    for each in range(passes):
        count = spp * (each + 1) // passes - spp * each // passes
        own = int(np.random.SeedSequence([*seed, each]).generate_state(1)[0])
        image = mi.render(scene, integrator=integrator, spp=count, seed=own)
        whole = whole + count / spp * np.array(image)[..., :3]
    return whole


@cache
def _register_tinted_fiber() -> None:
    """Add the ``fiber`` emitter times a color to Mitsuba: ``red``, ``green``, ``blue`` in [0, 1].

    The class derives from the current variant's emitter.
    """
    import drjit as dr
    import mitsuba as mi

    from render.integrators.fiber_emitter import FiberEmitter

    class TintedFiber(FiberEmitter):
        def __init__(self, props: Any) -> None:
            FiberEmitter.__init__(self, props)
            color = [float(props.get(name, 1.0)) for name in ("red", "green", "blue")]
            self.tint = mi.Color3f(color)
            dr.make_opaque(self.tint)  # another color needs no new kernel

        def radiance(self, local: Any) -> Any:
            return FiberEmitter.radiance(self, local) * self.tint

    mi.register_emitter("tinted_fiber", TintedFiber)
