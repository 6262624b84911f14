"""When noise hides the score of a render, and what it would take."""

from __future__ import annotations

from optimize.design import Array, ScoreSettings
from render.noise_share import UNCONVERGED_SHARE, converging_effort, noise_share
from render.reference import more_effort


def noise_doubt(
    settings: ScoreSettings, replicates: Array, power: Array, samples: int | None = None
) -> str:
    """Say that noise hides what the score is made of; "" where it does not.

    ``samples`` are those per cell; without them it asks for multiples.
    """
    share = noise_share(replicates, power, settings.exposure, settings.conventions)
    if share <= UNCONVERGED_SHARE:
        return ""
    asked = more_effort(converging_effort(share), samples)
    return f"noise makes {share:.0%} of what its facets differ by; {asked}"
