"""Random numbers of light paths against splitmix64's published ones."""

from __future__ import annotations

import numpy as np

from render.preview.converged.walks import begin_stream, uniform

PUBLISHED = (
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
)
"""The first five of seed 1234567 (Rosetta Code, of Vigna's program)."""


def test_numbers_are_those_that_are_published_for_a_seed() -> None:
    state = np.array([1234567], np.uint64)
    assert [uniform(state) for _ in PUBLISHED] == [(z >> 11) * 2.0**-53 for z in PUBLISHED]


def test_streams_of_neighboring_paths_and_families_know_nothing_of_each_other() -> None:
    state, numbers = np.zeros(1, np.uint64), np.empty((2, 2000, 2))
    for family in range(2):
        for path in range(2000):
            begin_stream(state, family << 40, path)
            numbers[family, path] = uniform(state), uniform(state)
    columns = numbers.transpose(0, 2, 1).reshape(4, -1)
    pairs = np.concatenate([columns[:, :-1], columns[:, 1:]])
    between = np.corrcoef(pairs) - np.eye(8)
    assert np.abs(between).max() < 5 / np.sqrt(2000)
    np.testing.assert_allclose(columns.mean(axis=1), 0.5, atol=5 / np.sqrt(12 * 2000))
