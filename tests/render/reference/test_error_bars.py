"""Error bars of transport cells, lit or not, from replicates of a known process."""

from __future__ import annotations

import numpy as np

from render.reference.error_bars import shared_weight, standard_error

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


def test_the_untouched_pad_has_no_facets_and_hidden_cells_stay_nan() -> None:
    replicates = rare(6, np.full(SHAPE[:4], 0.7), 0.1)
    replicates[..., 2] = np.nan
    error = standard_error(replicates)
    assert np.isnan(error[..., 2]).all()
    assert (np.delete(error, 2, axis=-1) > 0).all()


def test_where_nothing_at_all_is_lit_no_bar_is_made_up() -> None:
    assert (standard_error(np.zeros((8, *SHAPE))) == 0).all()
