"""Interpolation in direction and bend is exact on polynomials and stable at its nodes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from render.chebyshev import chebyshev_nodes, interpolation_weights

COUNTS = [1, 2, 3, 9, 13, 40]


@pytest.mark.parametrize("count", COUNTS[1:])
def test_nodes_ascend_and_include_both_ends(count: int) -> None:
    nodes = chebyshev_nodes(count, 0.0, np.pi)
    assert nodes[0] == 0.0
    assert nodes[-1] == np.pi
    assert (np.diff(nodes) > 0).all()
    np.testing.assert_allclose(nodes + nodes[::-1], np.pi)


def test_a_single_node_is_the_middle() -> None:
    np.testing.assert_array_equal(chebyshev_nodes(1, 0.0, 4.0), [2.0])
    np.testing.assert_array_equal(interpolation_weights(np.array([2.0]), np.zeros((2, 3))), 1.0)


@pytest.mark.parametrize("count", COUNTS)
def test_polynomials_below_the_node_count_are_exact(count: int) -> None:
    nodes = chebyshev_nodes(count, 0.0, np.pi)
    x = np.linspace(0.0, np.pi, 101)
    polynomial = np.polynomial.Chebyshev(
        np.random.default_rng(count).normal(size=count), domain=[0.0, np.pi]
    )
    weights = interpolation_weights(nodes, x)
    assert weights.shape == (101, count)
    np.testing.assert_allclose(weights @ polynomial(nodes), polynomial(x), atol=1e-11)


def test_smooth_functions_converge_fast() -> None:
    nodes, x = chebyshev_nodes(13, 0.0, np.pi), np.linspace(0.0, np.pi, 200)
    values = interpolation_weights(nodes, x) @ np.exp(-((nodes - 1.3) ** 2))
    np.testing.assert_allclose(values, np.exp(-((x - 1.3) ** 2)), atol=1e-4)


@pytest.mark.parametrize("count", COUNTS)
def test_nodes_reproduce_their_values_bit_for_bit(count: int) -> None:
    nodes = chebyshev_nodes(count, -1.0, 2.0)
    np.testing.assert_array_equal(interpolation_weights(nodes, nodes), np.eye(count))


@pytest.mark.parametrize("count", COUNTS[1:])
def test_a_rounding_error_beside_a_node_is_harmless(count: int) -> None:
    nodes = chebyshev_nodes(count, 0.0, np.pi)
    beside = np.concatenate([np.nextafter(nodes[1:], 0.0), [5e-324, 1e-310, 1e-250, 1e-100]])
    expected = np.concatenate([np.eye(count)[1:], np.tile(np.eye(count)[0], (4, 1))])
    np.testing.assert_allclose(interpolation_weights(nodes, beside), expected, atol=1e-12)


def test_any_distinct_nodes_in_any_order_will_do() -> None:
    nodes = np.array([3.0, 0.5, 2.0, 1.0])
    x = np.linspace(0.5, 3.0, 17)
    np.testing.assert_allclose(interpolation_weights(nodes, x) @ nodes**3, x**3)


def test_nan_stays_nan() -> None:
    assert np.isnan(interpolation_weights(chebyshev_nodes(5, 0.0, 1.0), np.array([np.nan]))).all()


@given(st.integers(1, 30), st.floats(0.0, np.pi))
def test_weights_sum_to_one(count: int, x: float) -> None:
    weights = interpolation_weights(chebyshev_nodes(count, 0.0, np.pi), np.array(x))
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
