"""Mitsuba's own path tracer on the whole design: what level 2 would cost without our renderer."""

from __future__ import annotations

import importlib
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.geometry.facet_masks import FacetMasks, facet_masks
from render.reference.llvm import mitsuba
from render.scene.schema import Scene

VARIANT = "llvm_ad_rgb"
_registered: list[str] = []


class PathTracer:
    """``volpath`` renders of one scene; only the part of the film that shows facets is rendered.

    Arguments of the constructor:
        scene: the sensor.
        bends: ``(bend,)`` rad.
    """

    def __init__(self, scene: Scene, bends: Array) -> None:
        """Find the pixels of all facets."""
        self.scene, self.bends = scene, bends
        self.masks = [facet_masks(scene, float(bend)) for bend in bends]

    def radiance(self, phi: Array, power: Array, spp: int, seed: int) -> tuple[Array, float]:
        """Render one design; return radiance ``(bend, site, facet, 3)`` and the seconds it took.

        Arguments:
            phi: ``(fiber,)`` rad.
            power: ``(fiber, 3)`` in [0, 1].
            spp: per pixel.
            seed: of all random numbers.
        """
        mi = _mitsuba()
        began = time.perf_counter()
        found = []
        for number, (bend, masks) in enumerate(zip(self.bends, self.masks, strict=True)):
            scene, crop = self._loaded(mi, phi, power, float(bend), masks)
            integrator = mi.load_dict({"type": "volpath"})
            image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed + number))
            film = np.full((masks.rows, masks.columns, 3), np.nan)
            film[crop] = image[..., :3]
            found.append(_means(film.reshape(-1, 3), masks))
        return np.stack(found), time.perf_counter() - began

    def _loaded(
        self, mi: Any, phi: Array, power: Array, bend: float, masks: FacetMasks
    ) -> tuple[Any, tuple[slice, slice]]:
        """Return the lit scene with its sensor, and the part of the film that it records."""
        from render.reference.lit_scene import fiber_disks, pinhole
        from render.reference.optics import pad_shapes

        used = masks.pixel
        row, column = used // masks.columns, used % masks.columns
        crop = (slice(row.min(), row.max() + 1), slice(column.min(), column.max() + 1))
        sigma_v = float(np.degrees(self.scene.fibers.sigma_v))
        emitters = {
            fiber: {
                "type": "tinted_fiber",
                "sigma_v": sigma_v,
                **dict(zip(("red", "green", "blue"), color.tolist(), strict=True)),
            }
            for fiber, color in enumerate(power)
        }
        content: dict[str, Any] = {
            "type": "scene",
            "sensor": pinhole(
                self.scene,
                masks.columns,
                masks.rows,
                crop_offset_x=int(crop[1].start),
                crop_offset_y=int(crop[0].start),
                crop_width=int(crop[1].stop - crop[1].start),
                crop_height=int(crop[0].stop - crop[0].start),
                pixel_format="rgb",
            ),
            **fiber_disks(self.scene, phi, bend, emitters),
        }
        with tempfile.TemporaryDirectory(prefix="tactilux-") as folder:
            content |= pad_shapes(self.scene, bend, True, Path(folder))
            return mi.load_dict(content, optimize=False), crop


def _mitsuba() -> Any:
    """Return Mitsuba in the color variant, with the tinted emitter registered."""
    mi = mitsuba(VARIANT)
    if not _registered:
        name = "optimize.frontier.tinted_fiber"
        sys.modules.pop(name, None)
        mi.register_emitter("tinted_fiber", importlib.import_module(name).TintedFiber)
        _registered.append(name)
    return mi


def _means(film: Array, masks: FacetMasks) -> Array:
    """Return the mean ``(site, facet, 3)`` of the pixels ``(pixel, 3)`` of every facet."""
    sums = np.add.reduceat(film[masks.pixel], masks.offset[:-1].clip(max=len(masks.pixel) - 1))
    counts = np.diff(masks.offset)[:, None]
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return np.asarray(mean.reshape(masks.sites, masks.facets + 1, 3)[:, :-1])
