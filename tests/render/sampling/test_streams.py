"""HashedStream primary samples."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np

from render.sampling.streams import HashedStream, hashed, uniform


def test_even_the_largest_bits_stay_below_one(mono: ModuleType) -> None:
    numbers = np.array(uniform(mono.UInt32([0, 1, 2**32 - 1])))
    assert numbers.min() == 0.0
    assert numbers.max() < 1.0


def test_hashed_numbers_are_uniform_and_uncorrelated_over_streams_and_events(
    mono: ModuleType,
) -> None:
    count = 1 << 16
    lanes = mono.UInt32(np.arange(count, dtype=np.uint32))
    drawn = [number for event in (0, 1, 7) for number in hashed(lanes, mono.UInt32(event))]
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


def test_a_stream_gives_the_same_numbers_for_an_event_however_often_it_is_asked(
    mono: ModuleType,
) -> None:
    stream = HashedStream(mono.UInt32([4, 5]))
    first = np.array([np.array(x) for x in stream.event(3)])
    stream.event(9)
    again = np.array([np.array(x) for x in stream.event(3)])
    np.testing.assert_array_equal(first, again)
    assert (first[:, 0] != first[:, 1]).all()
