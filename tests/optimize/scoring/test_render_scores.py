"""Scores from renders: freed of the noise's bias, with parts that add up."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from optimize.design import ScoreSettings
from optimize.scoring import RenderedScore, paired_difference, rendered_score
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
THIRDS = np.eye(3)[np.arange(8) * 3 // 8]


def noisy_score(table: TransportTable, noise: float, seed: int = 0) -> RenderedScore:
    """Return the score of 16 renders with the relative ``noise`` in every cell."""
    light = table.at(np.full(8, np.pi / 2))
    drawn = np.random.default_rng(seed).standard_normal((16, *light.shape))
    settings = ScoreSettings(table.exposure, table.lam)
    return rendered_score(settings, light * (1 + noise * drawn), THIRDS)


@pytest.mark.parametrize("noise", [0.01, 0.5])
def test_score_mean_and_spreads_of_noisy_renders_add_up(
    make_table: MakeTable, noise: float
) -> None:
    found = noisy_score(make_table(), noise)
    rating = found.rating
    assert rating.score == pytest.approx(
        rating.mean - rating.spread_sites - rating.spread_bends, rel=1e-9
    )
    assert rating.score == found.score.value
    assert rating.interval == found.score.interval()
    assert rating.level == "reference"
    assert all(part.se > 0 for part in found.parts.values())


def test_every_part_of_the_score_is_freed_of_the_noises_bias(make_table: MakeTable) -> None:
    table = make_table()
    exact = ScoreSettings(table.exposure, table.lam).parts(table.at(np.full(8, np.pi / 2)), THIRDS)
    found = [noisy_score(table, 0.3, seed) for seed in range(40)]
    for truth, name in zip(exact, found[0].parts, strict=True):
        plain = np.mean([one.parts[name].plain for one in found]) - truth
        left = np.mean([one.parts[name].value for one in found]) - truth
        noise = np.std([one.parts[name].value for one in found]) / np.sqrt(len(found))
        assert abs(left) < max(0.5 * abs(plain), 3 * noise), name


def test_designs_that_differ_by_names_of_colors_alone_are_equal(make_table: MakeTable) -> None:
    table = make_table()
    light = table.at(np.full(8, np.pi / 2))
    drawn = np.random.default_rng(1).standard_normal((16, *light.shape))
    replicates = light * (1 + 0.3 * drawn)
    settings = ScoreSettings(table.exposure, table.lam)
    renamed = paired_difference(settings, replicates, THIRDS, replicates, THIRDS[:, [1, 2, 0]])
    assert renamed.interval() == (0.0, 0.0)
    brighter = paired_difference(settings, replicates, THIRDS, 1.001 * replicates, THIRDS)
    assert brighter.interval()[0] > 0.0
