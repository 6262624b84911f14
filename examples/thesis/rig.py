"""Figs. 3.5 and 3.6 of the thesis on the emulated rig: photographs against simulation.

The thesis photographs a prototype. Here an emulated rig stands in (`hw.emulator`): its light is
rendered, its fibers have powers and directions of their own, and its camera has noise,
vignetting, a tilt and gains. The simulation is the preview, which is told the rig's
material and nothing else; one factor per photograph fits its brightness. What calibration finds
of an unknown material is measured in tests/validation/RESULTS.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import tactilux
from hw.calibration.material_table import fiber_images
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import NAMES, Setup, sample_image
from hw.calibration.rig_fit import measure
from hw.camera.photo_set import PhotoSet
from hw.emulator.demonstration import (
    calibration_bends,
    calibration_fibers,
    render_rig,
    single_exposure,
    switched_on,
)
from hw.emulator.emulated_camera import CameraImperfections, seen_by
from hw.emulator.rig import RAYS, random_parameters
from optimize.report import drawing, encode_srgb, png_bytes
from render.arrays import Array

FIBER = 5
"""In the middle of the left edge; photographed on the flat and on the bent pad."""
FRAMES = 16
TOGETHER = 0.15
"""Power at which all fibers together do not clip."""
INKS = ("#b45309", "#1d4ed8", "#15803d", "#6d28d9")


@dataclass(frozen=True, eq=False)
class Photographed:
    """What the rig showed, and what is simulated.

    Arguments:
        setup: what is known of the rig, its material included.
        sets: photographs of single fibers in white: all on the flat pad, half on the bent one.
        together: the flat baseline design, all fibers lit, dim; ``(row, column, 3)`` counts.
        measurements: what is read along the reference lines.
        simulated: ``(bend, fiber, row, column)``, the same without any imperfection.
        power: ``(fiber, 3)``, what was lit for ``together``.
    """

    setup: Setup
    sets: list[PhotoSet]
    together: Array
    measurements: list[Measurement]
    simulated: Array
    power: Array


@cache
def photographed(rig_samples: int, seed: int = 0) -> Photographed:
    """Render a rig, photograph it, and simulate the same, once."""
    scene = tactilux.load_scene("finger20")
    design, truth = tactilux.baseline_design(scene), random_parameters(scene, seed)
    images = render_rig(scene, truth, design, rig_samples)
    # Its channels see the color of their name alone: the simulation knows of no others.
    pure = replace(truth.imperfections, leak=CameraImperfections().leak)
    truth = replace(truth, imperfections=pure)
    truth = replace(truth, gain=single_exposure(truth, images))
    white, some = np.ones((scene.lamp_count, 3)), np.zeros((scene.lamp_count, 3))
    some[calibration_fibers(scene)[1]] = 1.0
    power = TOGETHER * design.drive
    with switched_on(scene, design, truth, images) as rig:
        sets = [rig.photos("flat", rig.camera(0), white), rig.photos("bent", rig.camera(1), some)]
        lit = rig.photos("all", rig.camera(0), power, frames=FRAMES, together=True)
    assert lit.together is not None
    setup = Setup(scene, design.phi, calibration_bends(scene))
    measurements = measure(setup, sets, truth.imperfections.noise)
    assert truth.material is not None  # calibration knows this scene
    drawn = fiber_images(setup.of(truth.material), rays=RAYS, seed=seed)
    straight = CameraImperfections()
    simulated = np.stack([seen_by(scene, images, straight) for images in drawn])
    return Photographed(setup, sets, lit.together, measurements, simulated, power)


def reference_lines(rig_samples: int, path: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Write Fig. 3.5: one fiber, flat and bent; photographs solid, simulation dashed."""
    say(f"rendering the rig, {rig_samples} light paths per fiber and cell")
    shown = photographed(rig_samples)
    setup, camera = shown.setup, shown.setup.scene.camera
    pixels = setup.line_pixels(camera.rows, camera.columns)
    result: dict[str, Any] = {}
    with drawing(9.0, 9.0) as figure:
        axes = figure.subplots(2, 2, width_ratios=(1, 2))
        for bend, (photos, row) in enumerate(zip(shown.sets, axes, strict=True)):
            (index,) = [i for i, one in enumerate(shown.measurements)
                        if (one.fiber, one.bend) == (FIBER, bend)]  # fmt: skip
            one = shown.measurements[index]
            seen = one.counts.mean(axis=1)
            simulated = sample_image(shown.simulated[bend, FIBER], pixels[bend, FIBER])
            both = one.used & np.isfinite(simulated)
            simulated *= (seen * simulated)[both].sum() / (simulated[both] ** 2).sum()
            photo = photos.alone[FIBER]
            row[0].imshow(encode_srgb(photo / photo.max()))
            row[0].set(xticks=[], yticks=[], title=f"bend {np.degrees(setup.bends[bend]):.0f}°")
            for line, (name, ink) in enumerate(zip(NAMES, INKS, strict=True)):
                on = (setup.lines.line == line) & both
                if not on.any():
                    continue
                at = pixels[bend, FIBER][on]
                row[0].plot(at[:, 0], at[:, 1], color=ink, lw=1.5)
                place, measured, model = setup.lines.place[on], seen[on], simulated[on]
                row[1].plot(place, measured, color=ink, label=name)
                row[1].plot(place, model, "--", color=ink)
                error = float(np.sqrt(np.mean((model / measured - 1) ** 2)))
                result.setdefault(f"bend {np.degrees(setup.bends[bend]):.0f}", {})[name] = {
                    "mm": place.tolist(),
                    "photograph": measured.round(2).tolist(),
                    "simulation": model.round(2).tolist(),
                    "relative_rms": error,
                }
            row[1].set(xlabel="mm along the line", ylabel="counts", ylim=(0, None))
            row[1].legend(fontsize=8)
        figure.suptitle("emulated rig, one fiber: photograph solid, simulation dashed", fontsize=10)
        path.write_bytes(png_bytes(figure, dpi=80))
    return result


def all_fibers(rig_samples: int, path: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Write Fig. 3.6: all fibers of the baseline, photograph and simulation side by side."""
    say(f"rendering the rig, {rig_samples} light paths per fiber and cell")
    shown = photographed(rig_samples)
    simulated = np.einsum("fyx,fc->yxc", shown.simulated[0], shown.power)
    photo = np.maximum(shown.together, 0.0)
    pad = simulated.max(axis=-1) > 0.05 * simulated.max()
    simulated *= (photo * simulated)[pad].sum(axis=0) / (simulated[pad] ** 2).sum(axis=0)
    with drawing(6.0, 5.0) as figure:
        axes = figure.subplots(1, 2)
        for axis, title, image in zip(
            axes, ("emulated photograph", "simulation"), (photo, simulated), strict=True
        ):
            axis.imshow(encode_srgb(image / np.percentile(photo[pad], 99.5)))
            axis.set(xticks=[], yticks=[], title=title)
        path.write_bytes(png_bytes(figure, dpi=80))
    return {
        "correlation": [float(np.corrcoef(photo[pad][:, c], simulated[pad][:, c])[0, 1])
                        for c in range(3)],
        "relative_rms": [float(np.sqrt(np.mean((simulated[pad][:, c] / photo[pad][:, c].mean()
                                                - photo[pad][:, c] / photo[pad][:, c].mean())
                                               ** 2))) for c in range(3)],
        "pixels": int(pad.sum()),
    }  # fmt: skip
