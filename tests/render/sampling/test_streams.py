"""HashedStream primary samples."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np

from render.sampling.streams import ROUNDS, HashedStream, hashed, tea, uniform


def test_even_the_largest_bits_stay_below_one(mono: ModuleType) -> None:
    numbers = np.array(uniform(mono.UInt32([0, 1, 2**32 - 1])))
    assert numbers.min() == 0.0
    assert numbers.max() < 1.0


def test_hashed_numbers_are_uniform_and_uncorrelated_over_streams_and_events(
    mono: ModuleType,
) -> None:
    count = 1 << 16
    lanes = mono.UInt32(np.arange(count, dtype=np.uint32))
    events = [(lanes, mono.UInt32(event)) for event in (0, 1, 7)]
    drawn = [number for numbers in hashed(*events) for number in numbers]
    dr.eval(drawn)
    numbers = np.array([np.array(number) for number in drawn])
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    for row in numbers:
        counts = np.bincount((row * 64).astype(int), minlength=64)
        chi2 = ((counts - count / 64) ** 2 / (count / 64)).sum()
        assert chi2 < 63 + 4 * np.sqrt(2 * 63)
    correlation = np.corrcoef(numbers) - np.eye(len(numbers))
    assert np.abs(correlation).max() < 5 / np.sqrt(count)


def test_the_hash_is_mitsubas_own(mono: ModuleType) -> None:
    rng = np.random.default_rng(1)
    words = [mono.UInt32(rng.integers(0, 1 << 32, 1000, dtype=np.uint32)) for _ in range(4)]
    truth = [*mono.sample_tea_32(*words[:2], ROUNDS), *mono.sample_tea_32(*words[2:], ROUNDS)]
    np.testing.assert_array_equal([np.array(x) for x in tea(words)], [np.array(x) for x in truth])


def test_a_stream_gives_the_same_numbers_for_an_event_however_often_it_is_asked(
    mono: ModuleType,
) -> None:
    stream = HashedStream(mono.UInt32([4, 5]))
    first = np.array([np.array(x) for x in stream.event(3)])
    stream.event(9)
    again = np.array([np.array(x) for x in stream.event(3)])
    np.testing.assert_array_equal(first, again)
    assert (first[:, 0] != first[:, 1]).all()
