"""The rendered rows: short runs of the reference and Mitsuba's own path tracer, resumable."""

from __future__ import annotations

import hashlib
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from optimize.frontier.held_out import (
    SHORT_SEED,
    TRACER_SEED,
    FrontierRow,
    HeldOutReference,
)
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.geometry import FacetMasks, facet_masks
from render.metric import clip_counts
from render.progress import OnProgress, Progress
from render.reference import Sampler, mitsuba
from render.scene import Scene

NAMES: dict[Sampler, str] = {"monte-carlo": "bidirectional, MIS", "pssmlt": "PSSMLT"}
VARIANT = "llvm_ad_rgb"


def short_rows(
    reference: HeldOutReference,
    samples: list[int],
    checkpoint: Path,
    report: OnProgress,
) -> list[FrontierRow]:
    """Return one row of the reference per number of samples, the last also by PSSMLT."""
    rows, designs = [], reference.designs
    kinds: list[tuple[int, Sampler]] = [(count, "monte-carlo") for count in samples]
    kinds.append((samples[-1], "pssmlt"))
    for number, (count, sampler) in enumerate(kinds):
        name = f"{NAMES[sampler]}, {count} samples"
        estimate = designs.render(
            name,
            samples=count,
            seed=SHORT_SEED + number,
            sampler=sampler,
            checkpoint=checkpoint,
            report=report,
        )
        short = HeldOutReference.of(estimate, designs, reference.exposure, reference.lam)
        rows.append(
            reference.row(
                name,
                short.counts,
                seconds=short.seconds / len(designs),
                scores=short.scores,
                note=f"{len(designs)} designs in one render",
            )
        )
    return rows


def path_tracer_rows(
    reference: HeldOutReference,
    spp: list[int],
    folder: Path,
    report: OnProgress,
) -> list[FrontierRow]:
    """Return one row of Mitsuba's ``volpath`` for each number of samples; every design is kept."""
    designs = reference.designs
    tracer = PathTracer(designs.scene)
    rows = []
    for number, count in enumerate(spp):
        name = f"volpath, {count} samples a pixel"
        radiance, seconds = [], []
        for design, (phi, power) in enumerate(zip(designs.phi, designs.power, strict=True)):
            report(Progress(design, len(designs), stage=name))
            seed = TRACER_SEED + 1000 * (number + 2 * design)
            digest = hashlib.sha256(f"{designs.scene.hash} {count} {seed}".encode())
            for values in (phi, power):
                digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
            path = folder / f"{digest.hexdigest()[:16]}.npz"
            kept = read_or_drop(path, "radiance", "seconds")
            if kept is None:
                values, spent = tracer.radiance(phi, power, count, seed)
                kept = {"radiance": values, "seconds": np.array(spent)}
                write_npz(path, kept)
            radiance.append(kept["radiance"])
            seconds.append(float(kept["seconds"]))
        report(Progress(len(designs), len(designs), stage=name))
        rows.append(
            reference.row(
                name,
                np.asarray(clip_counts(reference.exposure * np.stack(radiance))),
                seconds=float(np.median(seconds)),
                note="Mitsuba's own, whole designs; compiling included",
            )
        )
    return rows


class PathTracer:
    """Mitsuba's ``volpath`` on whole designs at the scene's bends: the cost without our renderer.

    Only the part of the film that shows facets is rendered.
    """

    def __init__(self, scene: Scene) -> None:
        """Find the pixels of all facets."""
        self.scene = scene
        self.masks = [facet_masks(scene, bend) for bend in scene.bending.angles]

    def radiance(self, phi: Array, power: Array, spp: int, seed: int) -> tuple[Array, float]:
        """Render one design; return radiance ``(bend, site, facet, 3)`` and the seconds it took.

        Arguments:
            phi: ``(fiber,)`` rad.
            power: ``(fiber, 3)`` in [0, 1].
            spp: per pixel.
            seed: of all random numbers.
        """
        mi = mitsuba(VARIANT)
        _register_tinted_fiber()
        began = time.perf_counter()
        radiance = []
        for number, (bend, masks) in enumerate(
            zip(self.scene.bending.angles, self.masks, strict=True)
        ):
            scene, crop = self._lit(mi, phi, power, bend, masks)
            integrator = mi.load_dict({"type": "volpath"})
            image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed + number))
            film = np.full((masks.rows, masks.columns, 3), np.nan)
            film[crop] = image[..., :3]
            radiance.append(_facet_means(film.reshape(-1, 3), masks))
        return np.stack(radiance), time.perf_counter() - began

    def _lit(
        self, mi: Any, phi: Array, power: Array, bend: float, masks: FacetMasks
    ) -> tuple[Any, tuple[slice, slice]]:
        """Return the lit Mitsuba scene with its sensor, and the part of the film it records."""
        from render.optics.lit_scene import fiber_disks, pinhole
        from render.optics.pad_scene import pad_shapes

        row, column = masks.pixel // masks.columns, masks.pixel % masks.columns
        crop = (slice(row.min(), row.max() + 1), slice(column.min(), column.max() + 1))
        emitters = {
            fiber: {
                "type": "tinted_fiber",
                "sigma_v": float(np.degrees(self.scene.fibers.sigma_v)),
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

        def _radiance(self, local: Any) -> Any:
            return FiberEmitter._radiance(self, local) * self.tint

    mi.register_emitter("tinted_fiber", TintedFiber)


def _facet_means(film: Array, masks: FacetMasks) -> Array:
    """Return the mean ``(site, facet, 3)`` of the pixels ``(pixel, 3)`` of every facet."""
    sums = np.add.reduceat(film[masks.pixel], masks.offset[:-1].clip(max=len(masks.pixel) - 1))
    counts = np.diff(masks.offset)[:, None]
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return np.asarray(mean.reshape(masks.sites, masks.facets + 1, 3)[:, :-1])
