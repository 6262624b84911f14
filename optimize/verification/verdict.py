"""The verdict: finalists rendered once more, with seeds that had no part in choosing them.

Whoever wins a noisy contest was lucky as well as good. So the scores that are reported come from
renders of their own, and all finalists share them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from optimize.design.design import Design
from optimize.design.rating import ScoreSettings
from optimize.scoring.jackknife import JackknifeEstimate
from optimize.scoring.rendered_score import RenderedScore, paired_difference, rendered_score
from optimize.verification.renders import DesignRenders, RenderDesigns

PLURAL = ("colors",)
"""Names of finalists that stand for several things."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Fresh scores of the finalists and their paired differences.

    Arguments:
        names: of the finalists, in the order of everything else.
        measured: their scores.
        renders: what they come from.
    """

    names: tuple[str, ...]
    measured: tuple[RenderedScore, ...]
    renders: DesignRenders
    scale: ScoreSettings

    def of(self, name: str) -> RenderedScore:
        """Return the finalist's scores."""
        return self.measured[self.names.index(name)]

    def gain(self, first: str, second: str) -> JackknifeEstimate:
        """Return S of the second finalist minus S of the first, paired."""
        i, j = self.names.index(first), self.names.index(second)
        low, high = self.renders.designs[i], self.renders.designs[j]
        replicates = self.renders.replicates
        return paired_difference(
            self.scale, replicates[:, i], low.power, replicates[:, j], high.power
        )

    def sentence(self, first: str, second: str) -> str:
        """Say which of two finalists is better, or that the renders cannot tell."""
        low, high = self.gain(first, second).interval()
        interval = f"95% interval of the difference {low:.2f} to {high:.2f}"
        if low > 0 or high < 0:
            better, worse = (second, first) if low > 0 else (first, second)
            verb = "are" if better in PLURAL else "is"
            return f"The {better} {verb} better than the {worse} ({interval})."
        return f"The {second} and the {first} tie ({interval})."


def pronounce(
    render: RenderDesigns,
    scale: ScoreSettings,
    finalists: Sequence[tuple[str, Design]],
    *,
    samples: int,
    seeds: Sequence[int],
) -> Verdict:
    """Render the ``finalists`` together and score them; ``seeds`` must be fresh ones."""
    renders = render(
        [design for _, design in finalists],
        samples=samples,
        seeds=seeds,
        title="the finalists",
    )
    measured = tuple(
        rendered_score(scale, renders.replicates[:, i], design.power)
        for i, (_, design) in enumerate(finalists)
    )
    return Verdict(tuple(name for name, _ in finalists), measured, renders, scale)
