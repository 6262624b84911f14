"""A night with invented renders: what the shipped surrogate says, with noise put on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.design import Array, Design, baseline_design
from optimize.overnight.night import Finalist, Night, Step, keep_scene
from optimize.score_scale import Scale
from render.metric import design_score, site_metric
from render.scene import Scene
from surrogate.checker import Checker

MODELS = Path(__file__).parents[3] / "models"
NOISE = 0.01  # relative, of invented renders
TITLES = {
    "baseline": "Baseline",
    "colours": "Colours",
    "thesis": "Thesis procedure",
    "winner": "Winner",
    "runner-up": "Runner-up",
}


@pytest.fixture(scope="session")
def finger20_checker(finger20: Scene) -> Checker:
    return Checker.load(MODELS / "finger20", finger20.hash)


@pytest.fixture(scope="session")
def finished_night(finger20: Scene, finger20_checker: Checker) -> Night:
    """Return a night of five finalists and two rounds."""
    rng = np.random.default_rng(11)
    straight = np.full(20, np.pi / 2)
    halves = [0, 0, 0, 0, 2, 2, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1]
    thirds = [2, 2, 2, 0, 0, 0, 0, 0, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1]
    designs = {
        "baseline": baseline_design(finger20),
        "colours": Design.of_colours(straight, thirds),
        "thesis": Design.of_colours(straight + 0.1, thirds),
        "winner": Design.of_colours(straight + rng.uniform(-0.4, 0.4, 20), thirds),
        "runner-up": Design.of_colours(straight + rng.uniform(-0.4, 0.4, 20), halves),
    }
    finalists = tuple(
        _finalist(finger20, finger20_checker, rng, key, design) for key, design in designs.items()
    )
    first = finalists[0].score
    finalists = tuple(
        entry
        if entry.key == "baseline"
        else Finalist(**{**vars(entry), "gain": entry.score - first, "gain_se": 0.9})
        for entry in finalists
    )
    rows = zip(("baseline", "best", "uncertain", "random"), finalists, strict=False)
    steps = tuple(
        Step("search", number, role, 600.0 * number, entry.score - 4 / number, 1.5, entry.predicted)
        for number in (1, 2)
        for role, entry in list(rows)
    )
    return Night(
        scene=finger20,
        scale=Scale(finger20_checker.exposure, finger20_checker.lam),
        replicates=16,
        finalists=finalists,
        winner="winner",
        verdict=(
            "The winner is better than the baseline (95% interval of the difference 30 to 36).",
            "The winner and the runner-up tie (95% interval of the difference -1.2 to 2.0).",
        ),
        steps=steps,
        trade=(
            _level("preview", 0.004, 0.028, 0.087, 1.94, 0.93),
            _level("checker.onnx", 0.0006, 0.013, 0.029, 0.95, 0.96),
            _level("PSSMLT, 96 mutations", 9.0, 0.03, 0.07, 2.4, 0.91),
        ),
        facts=(("Scene", f"finger20, {finger20.hash}"), ("Seed", "0"), ("Budget", "8 h")),
    )


@pytest.fixture
def run_directory(tmp_path: Path, finished_night: Night) -> Path:
    """Return a directory in which the night is kept."""
    run = tmp_path / "run"
    keep_scene(run, "finger20")
    finished_night.save(run)
    return run


def _finalist(
    scene: Scene, checker: Checker, rng: np.random.Generator, key: str, design: Design
) -> Finalist:
    bends = np.array(scene.bending.angles)
    found = checker.run(design.phi[None], design.power[None], bends)
    predicted = np.asarray(found["counts"][0], dtype=np.float64)
    counts: Array = np.clip(predicted * (1 + NOISE * rng.standard_normal(predicted.shape)), 0, 255)
    metric = np.asarray(site_metric(counts, checker.lam))
    return Finalist(
        key=key,
        title=TITLES[key],
        design=design,
        score=float(design_score(metric).score),
        se=1.1,
        gain=None,
        gain_se=None,
        predicted=float(found["score"][0]),
        predicted_reach=checker.score_reach,
        counts=counts,
        counts_se=NOISE * predicted,
        predicted_counts=predicted,
        metric=metric,
        metric_se=np.full_like(metric, 1.0),
    )


def _level(
    name: str, seconds: float, median: float, p95: float, score: float, tau: float
) -> dict[str, float | str | None]:
    return {
        "level": name,
        "seconds_per_design": seconds,
        "facet_error_median": median,
        "facet_error_p95": p95,
        "score_error": score,
        "kendall_tau": tau,
    }
