"""The ladder in one script finds what the program finds, with fewer samples here."""

from __future__ import annotations

import re
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from render.metric import (
    MetricConfig,
    choose_exposure,
    choose_lambda,
    design_score,
    image_counts,
    site_metric,
)

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parents[2] / "examples" / "ladder.py"


@pytest.fixture(scope="module")
def ladder() -> ModuleType:
    spec = spec_from_file_location("ladder", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_its_score_is_the_programs(ladder: ModuleType) -> None:
    rng = np.random.default_rng(5)
    T, power = rng.gamma(2.0, 1e-3, (20, 3, 15, 10)), np.eye(3)[rng.integers(0, 3, 20)]
    exposure, lam = ladder.settings_of(T, power)
    radiance = image_counts(T, power, 1.0, MetricConfig(count_max=np.inf))
    assert exposure == pytest.approx(choose_exposure(radiance))
    counts = image_counts(T, power, exposure)
    assert lam == pytest.approx(choose_lambda(counts))
    found = ladder.score_of(ladder.counts_of(T, power, exposure), lam)
    assert found == pytest.approx(design_score(site_metric(counts, lam)).score)


def test_it_climbs_from_the_preview_to_rendered_scores(
    ladder: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["ladder.py", "--samples", "100"])
    monkeypatch.setattr(ladder, "STARTS", 1)
    ladder.main()
    said = capsys.readouterr().out
    scores = dict(re.findall(r"(baseline|best): rendered S (\S+ \+- \S+)", said))
    baseline, error = map(float, scores["baseline"].split(" +- "))
    best = float(scores["best"].split(" +- ")[0])
    # What the surrogate says of both: 234.1 and 272.5, within 1.
    assert abs(baseline - 234.1) < 4 * error + 12.0
    assert best > baseline
