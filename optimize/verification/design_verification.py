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

from optimize.design import RatedDesign, ScoreSettings
from optimize.scoring import JackknifeEstimate, RenderedScore, predict_design, search_table
from optimize.verification.design_renders import (
    DesignRenders,
    distinct_directions,
    reference_renders,
)
from optimize.verification.score_allocation import allocation_digest, score_allocation
from render.progress import OnProgress
from render.reference import (
    SampleAllocation,
    TimeBudget,
    render_within,
    samples_per_pass,
    stored_plan,
    transport_jobs,
)
from surrogate.runtime import Checker

SCORING_SECONDS, SCORING_FRACTION = 1.0, 0.01
"""What scores with their error bars take after the renders: seconds, and a part of the time."""


@dataclass(frozen=True, eq=False)
class Verification:
    """What the reference renderer says about a design and about the surrogate.

    ``doubt`` says why the renders have not converged; "" where they have.
    """

    baseline: RenderedScore
    design: RenderedScore
    difference: JackknifeEstimate
    surrogate_score: float
    render_seconds: float
    seeds: tuple[int, ...]
    samples: int
    doubt: str = ""

    def __repr__(self) -> str:
        """Return the difference and the conclusion in one line."""
        low, high = self.difference.interval()
        return (
            f"<Verification: {self.difference.value:+.1f} ({low:+.1f} to {high:+.1f}) against the "
            f"baseline. {self.conclusion}>"
        )

    def _repr_html_(self) -> str:
        """Return the line and the scores with their 95 % intervals."""
        from render.notebook import tabled

        rows = []
        for name, found in (
            ("baseline", self.baseline.score),
            ("design", self.design.score),
            ("difference", self.difference),
        ):
            low, high = found.interval()
            rows.append((name, f"{found.value:.1f}", f"{low:.1f} to {high:.1f}"))
        return tabled(repr(self), ("", "score, counts", "95 % interval"), rows)

    @property
    def conclusion(self) -> str:
        """The conclusion in one sentence."""
        if self.doubt:
            return f"The renders have not converged and decide nothing: {self.doubt}."
        low, high = self.difference.interval()
        if low > 0:
            return "The design is better in S than the baseline by more than the error bars."
        if high < 0:
            return "The design is worse in S than the baseline by more than the error bars."
        return "A tie in S: the difference is within the error bars; render longer to decide."

    def to_json(self) -> dict[str, Any]:
        """Return what programs rely on."""
        return {
            **{
                name: {
                    "score": rated.score.value,
                    "se": rated.score.se,
                    "interval": list(rated.score.interval()),
                    "clipped": rated.clipped,
                }
                for name, rated in (("baseline", self.baseline), ("design", self.design))
            },
            "difference": {
                "value": self.difference.value,
                "interval": list(self.difference.interval()),
            },
            "surrogate": {
                "score": self.surrogate_score,
                "error": self.surrogate_score - self.design.score.value,
            },
            "converged": not self.doubt,
            "render_seconds": self.render_seconds,
            "seeds": list(self.seeds),
        }


def verify(
    candidate: RatedDesign,
    model: Checker,
    *,
    samples: int,
    seeds: Sequence[int],
    per_pass: int | None = None,
    checkpoint: Path | None = None,
    progress: OnProgress | None = None,
) -> Verification:
    """Render the candidate and the baseline together, and compare them.

    Samples go where the model says that they tell most of the difference.

    Arguments:
        candidate: what is verified.
        model: the surrogate whose prediction is checked.
        samples: per cell and seed.
        seeds: common to both designs.
        per_pass: as of ``render_transport``.
        checkpoint: directory from which an interrupted verification goes on.
        progress: called every few seconds.
    """
    design, baseline = candidate.design, candidate.baseline
    render = reference_renders(candidate.scene, checkpoint, progress, per_pass=per_pass)
    pair = render(
        [baseline, design],
        samples=samples,
        seeds=seeds,
        title="baseline and design",
        allocation=pair_allocation(candidate, model),
    )
    bends = np.array(candidate.scene.state_axis)
    predicted = predict_design(model, design, bends)
    return paired_comparison(
        candidate.settings,
        pair,
        surrogate_score=float(predicted["score"]),
        seeds=tuple(seeds),
        samples=samples,
    )


def pair_allocation(candidate: RatedDesign, model: Checker) -> SampleAllocation:
    """Return the allocation of the renders of ``candidate`` and its baseline."""
    designs = [candidate.baseline, candidate.design]
    table = search_table(model)
    return score_allocation(candidate.scene, table, candidate.settings, designs, leader=1)


def paired_comparison(
    settings: ScoreSettings,
    pair: DesignRenders,
    *,
    surrogate_score: float,
    seeds: tuple[int, ...],
    samples: int,
) -> Verification:
    """Score the renders of the baseline and of a design, made with common seeds."""
    return Verification(
        baseline=pair.score(settings, 0),
        design=pair.score(settings, 1),
        difference=pair.difference(settings, 0, 1),
        surrogate_score=surrogate_score,
        render_seconds=pair.seconds,
        seeds=seeds,
        samples=samples,
        doubt=next(filter(None, (pair.doubt(settings, index, samples) for index in (1, 0))), ""),
    )


@dataclass(frozen=True)
class VerificationPlan:
    """What fitted into the minutes, see `verification_within`; kept in the folder of the renders.

    Arguments:
        scene_hash, design: the sensor, and the digest of the design with its rating.
        allocation: digest of where the samples go.
        minutes: of everything.
        seeds: common to both designs.
        samples, per_pass: per cell and seed, and of those in one pass (``transport_jobs``).
    """

    scene_hash: str
    design: str
    allocation: str
    minutes: float
    seeds: list[int]
    samples: int
    per_pass: int


def verification_within(
    candidate: RatedDesign,
    model: Checker,
    budget: TimeBudget,
    *,
    seeds: Sequence[int],
    folder: Path,
    progress: OnProgress | None = None,
) -> VerificationPlan:
    """Render for `verify` as long as there is time, and return what it shall ask for.

    The plan is kept in ``folder``: asked for the same again, nothing is rendered; with other
    minutes, renders go on from those that are there.

    Arguments:
        candidate: what is verified.
        model: as of `verify`.
        budget: of the whole command.
        seeds: common to both designs.
        folder: the checkpoint of `verify`.
        progress: called after every pass.
    """
    scene, allocation = candidate.scene, pair_allocation(candidate, model)
    wanted: dict[str, Any] = {
        "scene_hash": scene.hash,
        "design": candidate.digest,
        "allocation": allocation_digest(allocation),
        "minutes": budget.seconds / 60.0,
        "seeds": list(seeds),
    }
    phi, _ = distinct_directions([candidate.baseline, candidate.design])
    bends = np.array(scene.state_axis)

    def make() -> VerificationPlan:
        each = samples_per_pass(scene, budget.left(), len(bends) * len(seeds))
        jobs = transport_jobs(
            scene,
            phi,
            bends,
            samples=each,
            per_pass=each,
            seeds=seeds,
            allocation=allocation,
        )

        def scoring() -> float:
            return SCORING_SECONDS + SCORING_FRACTION * budget.seconds

        units = render_within(jobs, budget, folder, reserve=scoring, progress=progress)
        return VerificationPlan(samples=units * each, per_pass=each, **wanted)

    return stored_plan(folder / "plan.json", VerificationPlan, wanted, make)
