"""Verification: a design against the baseline by renders, with honest error bars.

Both designs are rendered with the same seeds. Scores come from the renderer's independent
replicates by the jackknife, because noise makes the plain score too low, and the difference is
jackknifed jointly so that noise which both share cancels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design import RatedDesign
from optimize.objectives import ERROR_KEYS, ReaderName
from optimize.readers import ModelColors, RenderedDegrees, rendered_degrees
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

    ``degrees`` are those of both readers, by name; ``doubt`` says why the renders have not
    converged; "" where they have.
    """

    baseline: RenderedScore
    design: RenderedScore
    difference: JackknifeEstimate
    surrogate_score: float
    render_seconds: float
    seeds: tuple[int, ...]
    samples: int
    degrees: Mapping[ReaderName, RenderedDegrees]
    doubt: str = ""

    def __repr__(self) -> str:
        """Return the difference and the conclusion in one line."""
        return f"<Verification: {' '.join(self.conclusions)}>"

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
    def conclusions(self) -> list[str]:
        """What the renders decide, the degrees of the sensor reader first."""
        if self.doubt:
            return [self.conclusion]
        return [self.reader_conclusion("sensor"), self.reader_conclusion("place"), self.conclusion]

    def reader_conclusion(self, reader: ReaderName) -> str:
        """Say in one sentence which design a reader reads better."""
        difference = self.error(reader, "difference")
        low, high = difference.interval()
        verdict = "reads both alike within the error bars; render longer to decide"
        if high < 0.0 or low > 0.0:
            word = "better" if high < 0.0 else "worse"
            verdict = f"reads the design {word} than the baseline by more than the error bars"
        change = f"{difference.value:+.2f}°, {low:+.2f}° to {high:+.2f}°"
        return f"The {reader} reader {verdict} ({change})."

    def error(self, reader: ReaderName, part: str) -> JackknifeEstimate:
        """Return a reader's error of ``baseline`` or ``design``, or their ``difference``, deg."""
        found = self.degrees[reader]
        if part == "difference":
            return found.difference(0, 1)
        return found.errors[("baseline", "design").index(part)]

    @property
    def conclusion(self) -> str:
        """The conclusion on S in one sentence."""
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
                    **self._degrees_to_json(name),
                }
                for name, rated in (("baseline", self.baseline), ("design", self.design))
            },
            "difference": {
                "value": self.difference.value,
                "interval": list(self.difference.interval()),
                **self._degrees_to_json("difference"),
            },
            "surrogate": {
                "score": self.surrogate_score,
                "error": self.surrogate_score - self.design.score.value,
            },
            "converged": not self.doubt,
            "render_seconds": self.render_seconds,
            "seeds": list(self.seeds),
        }

    def _degrees_to_json(self, part: str) -> dict[str, Any]:
        """Return both readers' degrees of ``baseline``, ``design`` or ``difference``."""
        told: dict[str, Any] = {}
        for reader, key in ERROR_KEYS.items():
            found = self.error(reader, part)
            told[f"{key}_deg"] = found.value
            told[f"{key}_interval"] = list(found.interval())
        return told


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
        candidate,
        pair,
        ModelColors.of(model, [baseline, design]),
        surrogate_score=float(predicted["score"]),
        seeds=tuple(seeds),
        samples=samples,
    )


def pair_allocation(candidate: RatedDesign, model: Checker) -> SampleAllocation:
    """Return the allocation of the renders of ``candidate`` and its baseline.

    Readers see the untouched pad too.
    """
    designs = [candidate.baseline, candidate.design]
    table = search_table(model)
    return score_allocation(
        candidate.scene, table, candidate.settings, designs, leader=1, untouched=True
    )


def paired_comparison(
    candidate: RatedDesign,
    pair: DesignRenders,
    model: ModelColors | None,
    *,
    surrogate_score: float,
    seeds: tuple[int, ...],
    samples: int,
) -> Verification:
    """Score and read the renders of the baseline and of ``candidate``, made with common seeds."""
    settings = candidate.settings
    return Verification(
        baseline=pair.score(settings, 0),
        design=pair.score(settings, 1),
        difference=pair.difference(settings, 0, 1),
        surrogate_score=surrogate_score,
        render_seconds=pair.seconds,
        seeds=seeds,
        samples=samples,
        degrees=rendered_degrees(candidate.scene, pair.colors(settings), model=model),
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
