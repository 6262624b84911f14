"""Which tolerance costs the most score: exact derivatives, and the loss over drawn sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from optimize.design import Array, Design
from optimize.robust.material_slopes import PER_FIBER
from optimize.robust.robust import QUANTILE
from optimize.robust.tolerance_draws import BuiltSensors
from optimize.scoring import Differentiator, TableScorer
from render.chebyshev import interpolation_weights
from render.scene.tolerances import Spread

DRAWS = 400


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What one tolerance does to the score of a design, in counts.

    Arguments:
        name: of the tolerance; sigma: its standard deviation (rad, mm or relative).
        slope: ``(F,)`` or ``(1,)`` exact derivative of S by the error, per fiber where each has
            its own.
        deviation: standard deviation of S to first order, ``|slope| sigma`` in quadrature.
        mean_loss: S as drawn minus its mean over sensors with this error alone; at an optimum the
            slope by direction is 0 and this is all that is left.
        low_loss: S as drawn minus its lower quantile over the same sensors.
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


def sensitivities(
    scorer: TableScorer,
    design: Design,
    spreads: Mapping[str, Spread],
    slopes: Mapping[str, Array],
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[Sensitivity]:
    """Return what every tolerance costs ``design``, the dearest first (thesis 6.2).

    Arguments:
        scorer: the surrogate's table.
        design: the design.
        spreads: tolerances by name.
        slopes: of the materials among them, from `material_slopes`.
        draws: sensors per tolerance.
        seed: of the draws.
    """
    exact = score_slopes(scorer, design, list(spreads), slopes)
    nominal, found = scorer.score(design.phi, design.power), []
    rng = np.random.default_rng(seed)
    for name, spread in spreads.items():
        sensors = BuiltSensors(scorer, {name: spread}, slopes, draws=draws, seed=seed)
        scores = sensors.scores(design)
        lows = np.quantile(rng.choice(scores, (200, draws)), QUANTILE, axis=1)
        found.append(
            Sensitivity(
                name=name,
                sigma=spread.sigma,
                slope=exact[name],
                deviation=float(np.linalg.norm(exact[name])) * spread.sigma,
                mean_loss=nominal - float(scores.mean()),
                low_loss=nominal - float(np.quantile(scores, QUANTILE)),
                low_loss_se=float(lows.std(ddof=1)),
            )
        )
    return sorted(found, key=lambda entry: -entry.low_loss)


def score_slopes(
    scorer: TableScorer, design: Design, names: list[str], slopes: Mapping[str, Array]
) -> dict[str, Array]:
    """Return exact derivatives of S by the errors ``names``, ``(F,)`` or ``(1,)`` each.

    Counts per rad for ``fiber_angle``, per mm for ``diffuser_thickness``, else per relative error.
    """
    gradient = Differentiator(scorer).at(design.phi, design.power)
    by_light = gradient.light.sum(axis=(1, 2, 3))
    weights = interpolation_weights(scorer.table.phi, design.phi)
    found: dict[str, Array] = {}
    for name in names:
        if name == "fiber_angle":
            found[name] = gradient.phi
        elif name in slopes:
            at = np.einsum("fj,fjbsk->fbsk", weights, slopes[name])
            found[name] = (gradient.light * at).sum(axis=(1, 2, 3))
        else:
            found[name] = by_light
        if name not in PER_FIBER:
            found[name] = found[name].sum(keepdims=True)
    return found
