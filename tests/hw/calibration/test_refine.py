"""A model that is wrong by a smooth field is brought to the truth by renders, and confirmed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from hw.calibration.material_table import MaterialTable
from hw.calibration.pad_light import BLOCKS, PadLight
from hw.calibration.reference_lines import Setup, frame_positions, in_frame
from hw.calibration.refine import Confirmation, refine
from hw.calibration.rig_fit import Calibration, fit_rig
from render.arrays import Array
from render.progress import Progress
from render.scene import Scene
from tests.hw.calibration.toy import BENDS, SPACE, TRUE, photographs, toy, toy_model
from tests.long import LONG

MATERIALS = 8
NOISE = 0.04
"""Relative error of the parts of the stand-in's cells; in renders, too, these are independent."""


def distortion(across: Array, along: Array) -> Array:
    """Return what the toy's table does not know: it looks like more absorption."""
    return -0.004 * along**2 - 0.01 * np.abs(across)


def stand_in(calls: list[Array]) -> Callable[..., PadLight]:
    """Return a renderer of the distorted toy; it notes the materials that it is asked for."""

    def render(
        setup: Setup,
        lit: Sequence[Sequence[int]],
        *,
        samples: int,
        seed: int,
        around: Array | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> PadLight:
        assert around is not None
        material = SPACE.of(setup.scene)
        calls.append(material)
        rng = np.random.default_rng(seed)
        radiance = np.full((len(setup.bends), len(setup.phi), 15 * BLOCKS, 9 * BLOCKS), np.nan)
        light = PadLight(2.0, BLOCKS, radiance, NOISE * np.ones(radiance.shape))
        for bend, fibers in enumerate(lit):
            for fiber in fibers:
                across, along = np.moveaxis(in_frame(setup.scene, fiber, light.positions()), -1, 0)
                away = np.maximum(along, 0.0)
                shape = toy(material, across, away, bend) + distortion(across, away)
                parts = rng.standard_normal((30, 18)).repeat(BLOCKS // 2, 0).repeat(BLOCKS // 2, 1)
                radiance[bend, fiber] = np.exp(shape) * (1 + NOISE * parts)
        if progress:
            progress(Progress(1, 1, 0.0, 0.0))
        return PadLight(2.0, BLOCKS, radiance, NOISE * radiance)

    return render


@dataclass
class Outcome:
    """The fits before and after renders, what confirms the latter, and the rendered materials."""

    first: Calibration
    found: Calibration
    confirmation: Confirmation
    calls: list[Array]


@pytest.fixture(scope="module")
def outcome(
    scene: Scene, table: MaterialTable, tmp_path_factory: pytest.TempPathFactory
) -> Outcome:
    """Photograph the distorted toy, fit the plain one, refine."""
    measurements, _ = photographs(scene, fibers=20 if LONG else 10)
    known = np.exp(distortion(*frame_positions().T))[:, None]
    distorted = [
        type(one)(
            one.fiber, one.bend, one.counts * known, one.used, one.channels, one.noise,
            one.radius2, one.tilt_slope * known,
        )
        for one in measurements
    ]  # fmt: skip
    model = toy_model(table)
    first = fit_rig(scene, model, distorted)
    calls: list[Array] = []
    found, confirmation = refine(
        Setup(scene, np.full(20, np.pi / 2), BENDS), model, first, distorted, materials=MATERIALS,
        samples=1, folder=tmp_path_factory.mktemp("cache"), render=stand_in(calls),
    )  # fmt: skip
    return Outcome(first, found, confirmation, calls)


def test_the_plain_model_alone_is_misled(outcome: Outcome) -> None:
    assert abs(outcome.first.material[1] / TRUE[1] - 1) > 0.3


def test_renders_lead_it_to_the_truth(outcome: Outcome) -> None:
    found = outcome.found
    error = np.abs(found.material - TRUE)
    assert (error < 3 * found.errors.material).all()
    assert abs(found.material[0] / TRUE[0] - 1) < 0.08
    assert set(found.errors.parts) == {"photographs", "model", "known"}


def test_the_last_render_is_of_the_material_that_is_reported(outcome: Outcome) -> None:
    np.testing.assert_allclose(outcome.calls[:MATERIALS], SPACE.sobol(MATERIALS))
    np.testing.assert_allclose(outcome.calls[-1], outcome.found.material)
    assert outcome.confirmation.renders == len(outcome.calls) >= MATERIALS + 2


def test_the_confirmation_explains_itself_by_noise(outcome: Outcome) -> None:
    told = outcome.confirmation
    assert 0.4 * told.noise < told.rms < 1.2 * told.noise
    assert told.before > 2 * told.rms
