"""The fit through the surrogate, brought to the reference: render, correct, fit again, confirm.

The first render is of the scene's own material, the others are of what was found so far. Each
corrects the model, together with those of nearly the same material, and the fit is repeated; until
it moves by less than its own error. The last render, with random numbers that no fit has seen, only
judges.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hw.calibration.confirm import Confirmation, against_light, against_model
from hw.calibration.fit import Calibration
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import field_modes, joined
from hw.calibration.reference_lines import reference_lines
from hw.calibration.rendered_correction import Render, rendered_correction
from hw.calibration.rig_fit import Model, fit_rig
from hw.pad_light import PadLight, render_pad_light
from render.bending import Array
from render.progress import Progress
from render.scene import Scene

NEAR = 0.1
"""Distance, in half ranges, within which a fit is expected to move."""
LEFT = 0.02
"""Relative error of the shape of light that even the best correction leaves: so much do corrected
models differ from emulated photographs of the same material."""
ROUNDS = 4
"""Renders at most."""
SETTLED = 1.0
"""Standard errors within which a repeated fit counts as unmoved."""
ALIKE = 2.0
"""Standard errors within which renders of two materials correct the model alike."""


@dataclass(frozen=True, eq=False)
class Refined:
    """What came out: the fit, the model that it was made with, and its confirmation."""

    found: Calibration
    model: Model
    confirmation: Confirmation


def refine(
    scene: Scene,
    model: Model,
    found: Calibration,
    measurements: list[Measurement],
    phi: Array,
    bends: Array,
    *,
    samples: int,
    progress: Callable[[int, Progress], None] | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> Refined:
    """Return the calibration as renders correct and confirm it.

    Arguments:
        scene: before calibration.
        model: that ``found`` was fitted with.
        found: the fit through the surrogate.
        measurements: the photographs.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        samples: light paths per photographed fiber and cell of the pad, for each render.
        progress: called every few seconds with the number of the render and its progress.
        render: what renders.
    """
    lines = reference_lines(scene)
    lit = [[one.fiber for one in measurements if one.bend == b] for b in range(len(bends))]
    where = np.where(lines.inside[..., None], lines.position, np.nan)
    original, moved, material = model, np.inf, _known(scene)
    renders: list[tuple[Array, Render]] = []
    began = time.monotonic()
    while True:
        number = len(renders) + 1

        def said(at: Progress, number: int = number) -> None:
            if progress:
                progress(number, at)

        light = render(
            material.put_into(scene), phi, bends, lit,
            samples=samples, seed=10 + number, around=where, progress=said,
        )  # fmt: skip
        renders.append((material.array(), Render(light, original.log_light(material))))
        if moved <= SETTLED or number == ROUNDS:
            break
        # The model is always corrected from where it began: corrections do not add up.
        near = _near(renders, found)
        correction = rendered_correction([one for _, one in near], lines)
        # Corrected there, the table is the less known the farther away the new fit goes.
        middle = np.mean([one for one, _ in near], axis=0)
        far = max(NEAR, original.table.distance(middle, found.material.array()))
        error = np.hypot(far * original.table.scatter(), LEFT)
        model = replace(
            original,
            log_correction=original.log_correction + correction.log_ratio,
            modes=joined(correction.modes, field_modes(error, len(phi))),
        )
        again = fit_rig(scene, model, measurements, material)
        step = (again.material.array() - found.material.array()) / again.intervals.material
        moved, found, material = float(np.abs(step).max()), again, again.material
    rms, noise = against_light(light, found, measurements, lines)
    before = against_model(original.log_light(_known(scene)), light, found, measurements, lines)
    return Refined(
        found,
        model,
        Confirmation(rms, noise, before, samples, time.monotonic() - began, len(renders)),
    )


def _near(renders: list[tuple[Array, Render]], found: Calibration) -> list[tuple[Array, Render]]:
    """Return the last render, and those before it of nearly the same material."""
    last = renders[-1][0]
    return [
        (material, one)
        for material, one in renders
        if np.all(np.abs(material - last) <= ALIKE * found.intervals.material)
    ]


def _known(scene: Scene) -> Material:
    """Return the scene's own material, brought into the range that the table knows."""
    return Material.from_array(np.clip(Material.of(scene).array(), LOW, HIGH))
