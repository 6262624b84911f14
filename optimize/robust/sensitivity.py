"""Which tolerance costs the most: exact derivatives, and the loss over perturbed sensors.

Slopes can be checked by finite differences on renders. All fibers then change together, so every
slope is one number: the sum over fibers. Powers and gain act linearly on one render. Directions on
both sides are nodes of the same run. Other materials need runs of their own, with the same seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optimize.design import Array, Design, RatedDesign
from optimize.robust.material_slopes import MATERIALS, PER_FIBER, neighbors
from optimize.robust.perturbed_sensors import QUANTILE, PerturbedSensors
from optimize.scoring import JackknifeEstimate, Merit, jackknife
from optimize.verification import reference_renders
from render.progress import OnProgress
from render.scene import Spread

DRAWS = 400
PHI_STEP, LIGHT_STEP = np.radians(10.0), 0.01
"""Steps of the checks on renders, rad and relative; that of light is small beside the kinks where
facets begin to clip."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What one tolerance does to a design: to S in counts, or to a reader's degrees.

    Arguments:
        name: of the tolerance; sigma: its standard deviation (rad, mm or relative).
        slope: ``(F,)`` or ``(1,)`` exact derivative of what is told by the error, per fiber where
            each has its own.
        deviation: its standard deviation to first order, ``|slope| sigma`` in quadrature.
        mean_loss: what is lost on average over sensors with this error alone; at an optimum the
            slope by direction is 0 and this is all that is left.
        low_loss: what one of the same sensors in ten loses more than.
        low_loss_se: bootstrap standard error of it.
    """

    name: str
    sigma: float
    slope: Array
    deviation: float
    mean_loss: float
    low_loss: float
    low_loss_se: float

    @property
    def worst_fiber(self) -> int | None:
        """The fiber whose error matters most, None for errors of the whole sensor."""
        return int(np.abs(self.slope).argmax()) if len(self.slope) > 1 else None

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "slope": self.slope.tolist(), "worst_fiber": self.worst_fiber}


def sensitivities(
    merit: Merit,
    design: Design,
    spreads: Mapping[str, Spread],
    slopes: Mapping[str, Array],
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[Sensitivity]:
    """Return what every tolerance costs ``design``, the dearest first (thesis 6.2).

    ``spreads`` are tolerances by name, ``slopes`` those of the materials among them, from
    `material_slopes`; every tolerance has ``draws`` sensors.
    """
    exact = exact_slopes(merit, design, list(spreads), slopes)
    nominal, losses = merit.value(design.phi, design.power), []
    rng = np.random.default_rng(seed)
    for name, spread in spreads.items():
        sensors = PerturbedSensors(merit, {name: spread}, slopes, draws=draws, seed=seed)
        values = sensors.values(design)
        lows = np.quantile(rng.choice(values, (200, draws)), QUANTILE, axis=1)
        losses.append(
            Sensitivity(
                name=name,
                sigma=spread.sigma,
                slope=merit.sign * exact[name],
                deviation=float(np.linalg.norm(exact[name])) * spread.sigma,
                mean_loss=nominal - float(values.mean()),
                low_loss=nominal - float(np.quantile(values, QUANTILE)),
                low_loss_se=float(lows.std(ddof=1)),
            )
        )
    return sorted(losses, key=lambda entry: -entry.low_loss)


def exact_slopes(
    merit: Merit, design: Design, names: list[str], slopes: Mapping[str, Array]
) -> dict[str, Array]:
    """Return exact derivatives of the merit by the errors ``names``, ``(F,)`` or ``(1,)`` each.

    Per rad for ``fiber_angle``, per mm for ``diffuser_thickness``, else per relative error.
    """
    gradient = merit.gradient(design.phi, design.power)
    cells = tuple(range(1, gradient.light.ndim))
    by_light = gradient.light.sum(axis=cells)
    derivatives: dict[str, Array] = {}
    for name in names:
        if name == "fiber_angle":
            derivatives[name] = gradient.phi
        elif name in slopes:
            at = merit.at(merit.flat(slopes[name]), design.phi)
            derivatives[name] = (gradient.light * at).sum(axis=cells)
        else:
            derivatives[name] = by_light
        if name not in PER_FIBER:
            derivatives[name] = derivatives[name].sum(keepdims=True)
    return derivatives


@dataclass(frozen=True, eq=False)
class CheckedSlope:
    """A slope by the surrogate and by finite differences on renders, with its error bar."""

    name: str
    surrogate: float
    rendered: JackknifeEstimate

    @property
    def sentence(self) -> str:
        """Whether both agree."""
        low, high = self.rendered.interval()
        word = "agrees" if low <= self.surrogate <= high else "does not agree"
        return (
            f"{self.name}: {self.surrogate:+.1f} by the surrogate, {self.rendered.value:+.1f} ± "
            f"{self.rendered.se:.1f} on renders; {word} (95% interval {low:+.1f} to {high:+.1f})."
        )

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {
            "name": self.name,
            "surrogate": self.surrogate,
            "rendered": self.rendered.value,
            "se": self.rendered.se,
            "interval": list(self.rendered.interval()),
        }


def check_slopes(
    candidate: RatedDesign,
    exact: Mapping[str, float],
    *,
    samples: int,
    seed: int,
    checkpoint: Path | None,
    progress: OnProgress | None = None,
) -> list[CheckedSlope]:
    """Return every slope of ``exact`` (sums over fibers) beside that of renders.

    ``exact`` is by the surrogate, per rad, mm or relative error. Every run has this ``seed`` and
    ``samples`` per cell; an interrupted one goes on in ``checkpoint``.
    """
    scene, design, settings = candidate.scene, candidate.design, candidate.settings
    turned = [
        replace(design, phi=np.clip(design.phi + sign * PHI_STEP, 0.0, np.pi))
        for sign in (-1.0, 1.0)
    ]

    def rendered(what: RatedDesign, designs: list[Design]) -> Array:
        render = reference_renders(what.scene, checkpoint, progress)
        return render(designs, samples=samples, seeds=[seed], title="neighbors").replicates

    def slope(pair: Array, width: float) -> JackknifeEstimate:
        """Return the difference quotient of ``pair`` ``(replicate, side, ...)``."""

        def quotient(mean: Array) -> float:
            scores = [settings.parts(side, design.power)[0] for side in mean]
            return float(scores[1] - scores[0]) / width

        return jackknife(quotient, pair)

    replicates, checked = rendered(candidate, [design, *turned]), []
    for name, value in exact.items():
        if name == "fiber_angle":
            pair, width = replicates[:, 1:], 2.0 * PHI_STEP
        elif name in MATERIALS:
            around = neighbors(scene, name)
            sides = [
                rendered(replace(candidate, scene=neighbor), [design])[:, 0]
                for neighbor in (around.below, around.above)
            ]
            pair, width = np.stack(sides, axis=1), 2.0 * around.step
        else:
            factors = np.exp([-LIGHT_STEP, LIGHT_STEP])
            pair = np.stack([factor * replicates[:, 0] for factor in factors], axis=1)
            width = 2.0 * LIGHT_STEP
        checked.append(CheckedSlope(name, value, slope(pair, width)))
    return checked
