"""Verification: a design against the baseline at level 2, with honest error bars.

Both designs are rendered with the same seeds. Scores come from the renderer's independent
replicates by the jackknife, because noise makes the plain score too low, and the difference is
jackknifed jointly so that noise which both share cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design import Array, RatedDesign, ScoreSettings
from optimize.scoring import JackknifeEstimate, RenderedScore, check_visible, predict_design
from optimize.verification.design_renders import DesignRenders, reference_renders
from render.progress import OnProgress
from render.reference import measure_render_cost, stored_plan
from render.scene import Scene
from surrogate.runtime import Checker

MIN_SAMPLES = 4
"""Samples per cell, however little time there is."""


@dataclass(frozen=True, eq=False)
class Verification:
    """What the reference renderer says about a design and about the surrogate."""

    baseline: RenderedScore
    design: RenderedScore
    difference: JackknifeEstimate
    surrogate_score: float
    render_seconds: float
    seeds: tuple[int, ...]
    samples: int

    @property
    def conclusion(self) -> str:
        """The conclusion in one sentence."""
        low, high = self.difference.interval()
        if low > 0:
            return "The design is better than the baseline by more than the error bars."
        if high < 0:
            return "The design is worse than the baseline by more than the error bars."
        return "This is a tie: the difference is within the error bars; render longer to decide."

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        both = {"baseline": self.baseline.score, "design": self.design.score}
        return {
            **{name: {"score": score.value, "se": score.se} for name, score in both.items()},
            "difference": {
                "value": self.difference.value,
                "interval": list(self.difference.interval()),
            },
            "surrogate": {
                "score": self.surrogate_score,
                "error": self.surrogate_score - self.design.score.value,
            },
            "render_seconds": self.render_seconds,
            "seeds": list(self.seeds),
        }


def verify(
    candidate: RatedDesign,
    model: Checker,
    *,
    samples: int,
    seeds: Sequence[int],
    checkpoint: Path | None = None,
    progress: OnProgress | None = None,
) -> Verification:
    """Render the candidate and the baseline, and compare them.

    Arguments:
        candidate: what is verified.
        model: the surrogate whose prediction is checked.
        samples: per cell and seed.
        seeds: common to both designs.
        checkpoint: directory from which an interrupted verification goes on.
        progress: called every few seconds; the stage is the design being rendered.
    """
    design, baseline = candidate.design, candidate.baseline
    render = reference_renders(candidate.scene, checkpoint, progress)
    first = render([baseline], samples=samples, seeds=seeds, title="baseline")
    second, seconds = first, first.seconds
    # Other colors need no other render: light is linear.
    if not candidate.recolored:
        second = render([design], samples=samples, seeds=seeds, title="design")
        seconds += second.seconds
    pair = DesignRenders(
        (baseline, design),
        np.concatenate([first.replicates, second.replicates], axis=1),
        np.concatenate([first.background, second.background], axis=1),
        seconds,
    )
    bends = np.array(candidate.scene.bending.angles)
    predicted = predict_design(model, design, bends)
    return paired_comparison(
        candidate.settings,
        pair,
        surrogate_score=float(predicted["score"]),
        seeds=tuple(seeds),
        samples=samples,
    )


def paired_comparison(
    settings: ScoreSettings,
    pair: DesignRenders,
    *,
    surrogate_score: float,
    seeds: tuple[int, ...],
    samples: int,
) -> Verification:
    """Score the renders of the baseline and of a design, made with common seeds.

    Raises:
        RenderError: the camera cannot see some facet, so the score is not defined.
    """
    check_visible(pair.replicates)
    return Verification(
        baseline=pair.score(settings, 0),
        design=pair.score(settings, 1),
        difference=pair.difference(settings, 0, 1),
        surrogate_score=surrogate_score,
        render_seconds=pair.seconds,
        seeds=seeds,
        samples=samples,
    )


@dataclass(frozen=True)
class VerificationPlan:
    """What is rendered, see `affordable_samples`; kept in the folder of the renders."""

    scene_hash: str
    minutes: float
    seeds: int
    designs: int
    samples: int


def affordable_samples(
    scene: Scene, phi: Array, *, minutes: float, seeds: int, designs: int, folder: Path
) -> int:
    """Return the samples per cell and seed that fill ``minutes``, at least MIN_SAMPLES.

    The choice is kept in ``folder``, so that a verification that was interrupted goes on with
    the same number instead of measuring again.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad, for the trial renders.
        minutes: rendering time for everything together.
        seeds: independent renders per bend and design.
        designs: how many are rendered, 1 when the other differs in colors alone.
        folder: of the checkpoint.
    """
    wanted: dict[str, Any] = {
        "scene_hash": scene.hash,
        "minutes": minutes,
        "seeds": seeds,
        "designs": designs,
    }

    def make() -> VerificationPlan:
        cost = measure_render_cost(scene, phi[:, None])
        renders = [1.0] * (len(scene.bending.angles) * seeds * designs)
        chosen = cost.samples_within(60.0 * minutes, renders, MIN_SAMPLES)
        return VerificationPlan(samples=chosen, **wanted)

    return stored_plan(folder / "plan.json", VerificationPlan, wanted, make).samples
