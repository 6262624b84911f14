"""How well calibration recovers rigs: random true materials, rendered photographs, real fits."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hw.calibration.line_model import LineModel
from hw.calibration.material import NAMES, PER_UNIT
from hw.calibration.refine import Confirmation, refine
from hw.calibration.rig_fit import Calibration, fit_rig, measure
from hw.emulator.rig import TrueParameters, random_parameters, rendered_images
from hw.emulator.session import BENDS, CALIBRATION_FIBERS, single_exposure, switched_on
from hw.errors import CalibrationError
from render.preview import cache_folder
from render.progress import OnProgress, in_stage
from tactilux import Design, Scene

BOUND = 0.10
"""Relative error that a value may have where its interval does not hold the truth."""
BOUNDED = NAMES[:3]


@dataclass(frozen=True)
class Recovered:
    """One value of one rig; units are those of `hw.calibration.material.UNITS`."""

    name: str
    true: float
    found: float
    interval: tuple[float, float]

    @property
    def error(self) -> float:
        """Relative error."""
        return self.found / self.true - 1

    @property
    def inside(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return self.interval[0] <= self.true <= self.interval[1]

    @property
    def good(self) -> bool:
        """Whether the value is within `BOUND`, or inside its interval."""
        return self.inside or abs(self.error) <= BOUND


@dataclass(frozen=True)
class RigOutcome:
    """What a calibration found on one rig.

    Arguments:
        seed: of the rig.
        surrogate: values after the fit through the surrogate alone.
        rendered: values after renders have corrected it.
        confirmation: what the last render said.
        refused: whether the fit ended beyond the known range, so that `tactilux hw calibrate`
            gives an error instead of a scene.
    """

    seed: int
    surrogate: tuple[Recovered, ...]
    rendered: tuple[Recovered, ...]
    confirmation: Confirmation
    refused: bool


def compared(found: Calibration, truth: TrueParameters) -> tuple[Recovered, ...]:
    """Return what was found beside the truth."""
    true_values, values = truth.material.array(), found.material.array()
    rows = zip(NAMES, PER_UNIT, true_values, values, found.intervals, strict=True)
    return tuple(
        Recovered(name, float(factor * true), float(factor * value), (factor * low, factor * high))
        for name, factor, true, value, (low, high) in rows
    )


def recover(
    scene: Scene,
    design: Design,
    model: LineModel,
    seed: int,
    *,
    rig_samples: int,
    materials: int,
    samples: int,
    progress: OnProgress | None = None,
) -> RigOutcome:
    """Render the photographs of the rig of ``seed``, calibrate on them and compare.

    Arguments:
        scene: what is known about the rig.
        design: its directions.
        model: of the reference lines at `BENDS`.
        seed: of the rig and of all its noise.
        rig_samples: light paths per fiber and cell of the photographs.
        materials: how many are rendered for all rigs.
        samples: light paths of the renders that correct and confirm.
        progress: called with what is rendered and how far it is.
    """
    truth = random_parameters(scene, seed)
    fibers = range(scene.fibers.count)
    images = rendered_images(
        scene, truth, design.phi, BENDS, [fibers[own] for own in CALIBRATION_FIBERS],
        samples=rig_samples, progress=in_stage(progress, f"photographs of rig {seed}"),
    )  # fmt: skip
    truth = replace(truth, gain=single_exposure(truth, images))
    with switched_on(scene, design, truth, images) as rig:
        sets = rig.calibration_sets()
    measurements = measure(scene, sets, BENDS, truth.imperfections.noise)
    first = fit_rig(scene, model, measurements)
    found, confirmation = refine(
        scene, model, first, measurements, design.phi, BENDS, materials=materials,
        samples=samples, folder=cache_folder(), progress=progress,
    )  # fmt: skip
    try:
        found.require_known()
        refused = False
    except CalibrationError:
        refused = True
    return RigOutcome(
        seed,
        compared(first, truth),
        compared(found, truth),
        confirmation,
        refused,
    )
