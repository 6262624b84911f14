"""Error bars of transport cells, lit or not, from replicates of a known process."""

from __future__ import annotations

import numpy as np

from render.reference.error_bars import (
    CellErrors,
    shared_weight,
    standard_error,
    with_lone_contributions,
)

SHAPE = (3, 4, 2, 5, 10)  # fiber, phi node, bend, site, facet


def rare(seed: int, expected: np.ndarray, size: float, replicates: int = 8) -> np.ndarray:
    """Return replicates whose means have ``expected`` contributions, of mean ``size`` in a mean."""
    rng = np.random.default_rng(seed)
    shape = (replicates, *expected.shape)
    found = rng.poisson(expected / replicates, shape)
    return replicates * size * rng.gamma(np.maximum(found, 1e-9), 1.0) * (found > 0)


def plain(replicates: np.ndarray) -> np.ndarray:
    return np.asarray(replicates.std(axis=0, ddof=1) / np.sqrt(len(replicates)))


def test_on_the_untouched_pad_a_lit_cells_error_is_the_spread_of_its_replicates() -> None:
    replicates = rare(1, np.full(SHAPE[:4], 3.0), 0.1)
    lit = replicates.mean(axis=0) > 0
    np.testing.assert_allclose(standard_error(replicates)[lit], plain(replicates)[lit], rtol=1e-12)


def test_facets_of_equal_contributions_share_nearly_all_of_their_variance() -> None:
    replicates = rare(1, np.full(SHAPE, 9.0), 0.1)
    assert shared_weight(replicates) > 0.9
    # Nine contributions of 0.1 whose mean square is twice their squared mean.
    truth = 0.1 * np.sqrt(2 * 9)
    spread = [
        np.std(np.log(error / truth)) for error in (standard_error(replicates), plain(replicates))
    ]
    assert spread[0] < 0.7 * spread[1]


def test_facets_whose_contributions_differ_widely_keep_their_own_variance() -> None:
    size = 10.0 ** np.random.default_rng(9).uniform(-4, 0, SHAPE[-1])
    replicates = size * rare(1, np.full(SHAPE, 9.0), 0.1)
    assert shared_weight(replicates) < 0.1
    typical = np.median(standard_error(replicates), axis=(0, 1, 2, 3))
    np.testing.assert_allclose(typical, size * 0.1 * np.sqrt(2 * 9), rtol=0.25)


def test_intervals_of_few_rare_contributions_cover_where_own_spreads_do_not() -> None:
    expected = np.random.default_rng(7).uniform(3.0, 12.0, SHAPE)
    shares = []
    for error_of in (standard_error, plain):
        covered = []
        for seed in range(6):
            replicates = rare(seed, expected, 0.1)
            off = np.abs(replicates.mean(axis=0) - 0.1 * expected)
            covered.append(off <= 2.365 * error_of(replicates))
        shares.append(np.mean(covered))
    assert 0.90 < shares[0] < 0.99
    assert shares[1] < 0.88


def test_fewer_than_four_replicates_cannot_tell_and_keep_their_own_spread() -> None:
    replicates = rare(8, np.full(SHAPE, 30.0), 0.1, replicates=3)
    np.testing.assert_allclose(standard_error(replicates), plain(replicates), rtol=1e-12)


def test_two_standard_errors_of_an_unlit_cell_reach_the_rule_of_three() -> None:
    # Contributions of several sizes: their mean weighted by size is twice their mean.
    replicates = rare(2, np.full(SHAPE, 1.0), 0.1)
    unlit = replicates.mean(axis=0) == 0
    assert unlit.mean() > 0.2
    found = standard_error(replicates)[unlit]
    np.testing.assert_allclose(found.mean(), 1.5 * 0.2, rtol=0.1)


def test_unlit_cells_are_covered_nineteen_times_in_twenty() -> None:
    # From cells that are nearly dark to cells that three contributions should have lit.
    expected = np.random.default_rng(3).uniform(0.0, 6.0, SHAPE)
    covered = []
    for seed in range(8):
        replicates = rare(seed, expected, 0.1)
        unlit = replicates.mean(axis=0) == 0
        reach = 2 * standard_error(replicates)
        covered += list((reach >= 0.1 * expected)[unlit])
    assert len(covered) > 100
    assert np.mean(covered) > 0.95


def test_contributions_of_other_fibers_do_not_count_where_the_own_one_lit_something() -> None:
    replicates = rare(4, np.full(SHAPE, 1.0), 0.1)
    replicates[:, 0] *= 1e3
    unlit = replicates.mean(axis=0) == 0
    error = standard_error(replicates)
    assert error[1:][unlit[1:]].max() < 1.0
    assert error[0][unlit[0]].min() > 50.0


def test_a_direction_that_lit_nothing_borrows_from_the_others_and_a_dark_fiber_from_all() -> None:
    replicates = rare(5, np.full(SHAPE, 2.0), 0.1)
    replicates[:, 0, 1] = 0.0
    replicates[:, 2] = 0.0
    error = standard_error(replicates)
    assert (error > 0).all()
    assert np.ptp(error[0, 1, 0]) == 0
    assert np.ptp(error[2, :, 0]) == 0


def test_the_untouched_pad_has_no_facets_and_error_bars_all_the_same() -> None:
    assert (standard_error(rare(6, np.full(SHAPE[:4], 0.7), 0.1)) > 0).all()


def test_where_nothing_at_all_is_lit_no_bar_is_made_up() -> None:
    assert (standard_error(np.zeros((8, *SHAPE))) == 0).all()


def glints(seed: int, samples: int, rate: float) -> tuple[np.ndarray, CellErrors]:
    """Return the expected light of cells, and what ``samples`` of each find of it.

    Light of 1 comes in many even contributions, and 2 in those of 2 / ``rate`` that one sample in
    1 / ``rate`` finds, for all facets of a site at once.
    """
    rng = np.random.default_rng(seed)
    even = rng.gamma(samples, 1.0 / samples, (8, *SHAPE))
    found = rng.poisson(samples * rate / 8, (8, *SHAPE[:4], 1)) * np.ones(SHAPE[4])
    size = 2.0 / rate / samples
    replicates = even + 8 * size * found
    mean = replicates.mean(axis=0)
    largest = np.where(found.sum(axis=0) > 0, size, 5.0 / samples)
    return np.full(SHAPE, 3.0), CellErrors(mean, standard_error(replicates), largest)


def test_cells_that_missed_what_their_peers_met_once_are_covered_too() -> None:
    without, within = [], []
    for seed in range(4):
        truth, cells = glints(seed, 600, rate=1 / 800)
        dark = CellErrors(*(np.full(SHAPE[:4], np.nan) for _ in range(3)))
        error, _ = with_lone_contributions(cells, dark, 2.0)
        off = np.abs(cells.mean - truth)
        missed = cells.mean < 1.5
        assert missed.mean() > 0.3
        without.append((off <= 2.365 * cells.error)[missed].mean())
        within.append((off <= 2.365 * error).mean())
    assert np.mean(without) < 0.05
    assert np.mean(within) > 0.9


def test_a_cell_of_which_one_contribution_is_a_third_is_uncertain_by_half_of_it() -> None:
    mean, error = np.ones(SHAPE), np.full(SHAPE, 0.1)
    largest = np.full(SHAPE, 0.01)
    largest[0, 0, 0, 0, 0] = 0.34
    sites = CellErrors(mean[..., 0], error[..., 0], largest[..., 1])
    found, background = with_lone_contributions(CellErrors(mean, error, largest), sites, 2.0)
    assert found[0, 0, 0, 0, 0] > 0.5
    # One of 55 cells: another one's error grows by sqrt(0.1^2 + 0.34^2 / 55) and a site's by less,
    # and cells under other light keep theirs.
    np.testing.assert_allclose(found[0, 0, 0, 1], np.hypot(0.1, 0.34 / np.sqrt(55)))
    np.testing.assert_allclose(background[0, 0, 0], np.hypot(0.1, 0.34 / np.sqrt(110)))
    np.testing.assert_array_equal(found[1:], error[1:])
    np.testing.assert_array_equal(found[0, 1:], error[0, 1:])


def test_where_no_contribution_stands_alone_errors_are_those_of_the_replicates() -> None:
    _, cells = glints(1, 100_000, rate=0.01)
    sites = CellErrors(*(part[..., 0] for part in (cells.mean, cells.error, cells.largest)))
    found, background = with_lone_contributions(cells, sites, 2.0)
    np.testing.assert_array_equal(found, cells.error)
    np.testing.assert_array_equal(background, sites.error)


def test_cells_that_nobody_sees_stay_nan_beside_lone_contributions() -> None:
    _, cells = glints(2, 600, rate=1 / 800)
    parts = [part.copy() for part in (cells.mean, cells.error, cells.largest)]
    for part in parts:
        part[..., 2, 3] = np.nan
    sites = CellErrors(*(part[..., 0] for part in parts))
    found, _ = with_lone_contributions(CellErrors(*parts), sites, 2.0)
    assert np.isnan(found[..., 2, 3]).all()
    assert np.isfinite(np.delete(found, 2, axis=3)).all()
