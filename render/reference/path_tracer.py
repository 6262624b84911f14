"""Mitsuba's own path tracer on whole designs: what the ladder costs without our renderer."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.geometry import FacetMasks, facet_masks
from render.reference.llvm import mitsuba
from render.scene import Scene

VARIANT = "llvm_ad_rgb"


class PathTracer:
    """Mitsuba's ``volpath`` at the scene's bends.

    Only the part of the film that shows facets is rendered.
    """

    def __init__(self, scene: Scene) -> None:
        """Find the pixels of all facets."""
        self.scene = scene
        self.masks = [facet_masks(scene, bend) for bend in scene.bending.angles]

    def radiance(self, phi: Array, power: Array, spp: int, seed: int) -> Array:
        """Return radiance ``(bend, site, facet, 3)`` of one design; ``spp`` is per pixel."""
        mi = mitsuba(VARIANT)
        _register_tinted_fiber()
        radiance = []
        for number, (bend, masks) in enumerate(
            zip(self.scene.bending.angles, self.masks, strict=True)
        ):
            scene, crop = self._lit(mi, phi, power, bend, masks)
            integrator = mi.load_dict({"type": "volpath"})
            image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed + number))
            film = np.full((masks.rows, masks.columns, 3), np.nan)
            film[crop] = image[..., :3]
            pixels = film.reshape(-1, 3)
            sites, facets = range(masks.sites), range(masks.facets)
            radiance.append([[pixels[masks.of(s, f)].mean(axis=0) for f in facets] for s in sites])
        return np.array(radiance)

    def _lit(
        self, mi: Any, phi: Array, power: Array, bend: float, masks: FacetMasks
    ) -> tuple[Any, tuple[slice, slice]]:
        """Return the lit Mitsuba scene with its sensor, and the part of the film it records."""
        from render.optics.lit_scene import fiber_disks, pinhole
        from render.optics.pad_scene import pad_shapes

        row, column = masks.pixel // masks.columns, masks.pixel % masks.columns
        top, left = int(row.min()), int(column.min())
        height, width = int(row.max()) + 1 - top, int(column.max()) + 1 - left
        emitters = {
            fiber: {
                "type": "tinted_fiber",
                "sigma_v": float(np.degrees(self.scene.fibers.sigma_v)),
                **dict(zip(("red", "green", "blue"), color.tolist(), strict=True)),
            }
            for fiber, color in enumerate(power)
        }
        sensor = pinhole(
            self.scene,
            masks.columns,
            masks.rows,
            crop_offset_x=left,
            crop_offset_y=top,
            crop_width=width,
            crop_height=height,
            pixel_format="rgb",
        )
        disks = fiber_disks(self.scene, phi, bend, emitters)
        with tempfile.TemporaryDirectory(prefix="tactilux-") as folder:
            pad = pad_shapes(self.scene, bend, True, Path(folder))
            content = {"type": "scene", "sensor": sensor, **disks, **pad}
            crop = (slice(top, top + height), slice(left, left + width))
            return mi.load_dict(content, optimize=False), crop


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
