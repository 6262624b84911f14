"""Slopes of the score by tolerances, checked by finite differences on renders.

All fibers change together, so every slope is one number: the sum over fibers. Powers and gain act
linearly on one render. Directions on both sides are nodes of the same run. Other materials need
runs of their own, with the same seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optimize.design import Array, Design, RatedDesign
from optimize.robust.material_slopes import MATERIALS, neighbors
from optimize.scoring import JackknifeEstimate, jackknife
from optimize.verification.design_renders import reference_renders
from render.progress import Progress

TURN = np.radians(10.0)
BRIGHTEN = 0.01
"""Relative step of light: small beside the kinks where facets begin to clip."""


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
    progress: Callable[[Progress], None] | None = None,
) -> list[CheckedSlope]:
    """Return every slope of ``exact`` (sums over fibers) beside that of renders.

    Arguments:
        candidate: the design with its scene and settings.
        exact: slopes by the surrogate, per rad, mm or relative error.
        samples: per cell and run.
        seed: of every run.
        checkpoint: folder where an interrupted check goes on.
        progress: called as each run goes on.
    """
    scene, design, scale = candidate.scene, candidate.design, candidate.settings
    turned = [
        replace(design, phi=np.clip(design.phi + sign * TURN, 0.0, np.pi)) for sign in (-1.0, 1.0)
    ]

    def rendered(what: RatedDesign, designs: list[Design]) -> Array:
        render = reference_renders(
            what.scene, checkpoint, None if progress is None else lambda _, at: progress(at)
        )
        return render(designs, samples=samples, seeds=[seed], title="neighbors").replicates

    def slope(pair: Array, width: float) -> JackknifeEstimate:
        """Return the difference quotient of ``pair`` ``(replicate, side, ...)``."""

        def quotient(mean: Array) -> float:
            scores = [scale.parts(side, design.power)[0] for side in mean]
            return float(scores[1] - scores[0]) / width

        return jackknife(quotient, pair)

    replicates, found = rendered(candidate, [design, *turned]), []
    for name, value in exact.items():
        if name == "fiber_angle":
            pair, width = replicates[:, 1:], 2.0 * TURN
        elif name in MATERIALS:
            around = neighbors(scene, name)
            sides = [
                rendered(replace(candidate, scene=one), [design])[:, 0]
                for one in (around.below, around.above)
            ]
            pair, width = np.stack(sides, axis=1), 2.0 * around.step
        else:
            factors = np.exp([-BRIGHTEN, BRIGHTEN])
            pair = np.stack([factor * replicates[:, 0] for factor in factors], axis=1)
            width = 2.0 * BRIGHTEN
        found.append(CheckedSlope(name, value, slope(pair, width)))
    return found
