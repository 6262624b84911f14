"""Proposals in primary sample space, and what chains store of them."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest

from render.sampling.proposals import (
    LIGHT_EVENTS,
    STEP_LARGE,
    STEP_SMALL,
    MutatedStream,
    Mutation,
    Splat,
    perturb,
)

COUNT = 100_000
LANES, CAMERA, PATHS, LIGHT = 64, 3, 2, 4


def moves(mono: ModuleType, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    number = mono.Float(rng.random(len(start)).astype(np.float32))
    moved = np.array(perturb(mono.Float(start.astype(np.float32)), number), dtype=np.float64)
    step = moved - start.astype(np.float32)
    return moved, step - np.round(step)


@pytest.mark.parametrize("value", [0.0, 0.5, 0.9999999])
def test_a_perturbed_number_stays_in_the_unit_interval_and_wraps_around(
    mono: ModuleType, value: float
) -> None:
    moved, step = moves(mono, np.full(COUNT, value))
    assert moved.min() >= 0.0
    assert moved.max() < 1.0
    size = np.abs(step)
    assert size.min() > 0.99 * STEP_SMALL
    assert size.max() < 1.01 * STEP_LARGE
    if value != 0.5:
        assert (moved > 0.9).any()
        assert (moved < 0.1).any()


def test_steps_up_and_down_are_equally_likely_at_every_size(mono: ModuleType) -> None:
    _, step = moves(mono, np.full(COUNT, 0.5))
    edges = np.geomspace(STEP_SMALL, STEP_LARGE, 9)
    up, _ = np.histogram(step, edges)
    down, _ = np.histogram(-step, edges)
    assert (np.abs(up - down) < 4 * np.sqrt(up + down)).all()
    # Exponentially distributed: as many steps in every octave.
    assert (np.abs(up - COUNT / 16) < 5 * np.sqrt(COUNT / 16)).all()


@pytest.fixture
def proposed(mono: ModuleType) -> tuple[MutatedStream, MutatedStream]:
    rng = np.random.default_rng(7)
    slots = CAMERA + PATHS * LIGHT
    memory = [mono.Float(rng.random(slots * LANES).astype(np.float32)) for _ in range(4)]
    lane = mono.UInt32(np.arange(LANES, dtype=np.uint32))
    seeds = [mono.UInt32(rng.integers(0, 2**32, LANES, dtype=np.uint32)) for _ in range(3)]
    mutation = Mutation(mono.Bool(rng.random(LANES) < 0.3), *seeds)
    return (
        MutatedStream.camera(memory, lane, LANES, mutation, CAMERA),
        MutatedStream.light(memory, lane, LANES, mutation, CAMERA, LIGHT, PATHS),
    )


def numbers(values: tuple[object, ...]) -> np.ndarray:
    dr.eval(values)
    return np.array([np.array(value) for value in values])


def lanes_of(mono: ModuleType, number: int) -> object:
    return mono.UInt32(np.full(LANES, number, dtype=np.uint32))


def test_what_is_stored_of_a_camera_path_is_what_the_path_was_made_of(
    mono: ModuleType, proposed: tuple[MutatedStream, MutatedStream]
) -> None:
    for event in range(CAMERA):
        np.testing.assert_array_equal(
            numbers(proposed[0].slot_numbers(lanes_of(mono, event))),
            numbers(proposed[0].event(lanes_of(mono, event))),
        )


def test_what_is_stored_of_light_paths_is_what_they_were_made_of(
    mono: ModuleType, proposed: tuple[MutatedStream, MutatedStream]
) -> None:
    for path in range(PATHS):
        for event in range(LIGHT):
            np.testing.assert_array_equal(
                numbers(proposed[1].slot_numbers(lanes_of(mono, path * LIGHT + event))),
                numbers(proposed[1].event(lanes_of(mono, path * LIGHT_EVENTS + event))),
            )


def test_only_large_steps_change_the_numbers_that_are_not_stored(
    mono: ModuleType, proposed: tuple[MutatedStream, MutatedStream]
) -> None:
    for stream, beyond in ((proposed[0], CAMERA + 2), (proposed[1], LIGHT + 2)):
        drawn = numbers(stream.event(lanes_of(mono, beyond)))
        mutation = stream.mutation
        stream.mutation = Mutation(
            mutation.large, mutation.fresh + 1, mutation.step + 1, mutation.tail
        )
        again = numbers(stream.event(lanes_of(mono, beyond)))
        large = np.array(mutation.large)
        np.testing.assert_array_equal(drawn[:, ~large], again[:, ~large])
        assert (drawn[:, large] != again[:, large]).mean() > 0.99


def test_a_small_step_moves_stored_numbers_by_a_small_amount(
    mono: ModuleType, proposed: tuple[MutatedStream, MutatedStream]
) -> None:
    camera = proposed[0]
    drawn = numbers(camera.event(lanes_of(mono, 1)))
    stored = np.array([np.array(array)[LANES : 2 * LANES] for array in camera.memory])
    small = ~np.array(camera.mutation.large)
    step = np.abs(drawn - stored)[:, small]
    assert np.minimum(step, 1 - step).max() < 1.01 * STEP_LARGE


def test_a_splat_is_selected_lane_by_lane(mono: ModuleType) -> None:
    a = Splat(mono.UInt32([1, 2]), [mono.Float([10, 20])])
    b = Splat(mono.UInt32([3, 4]), [mono.Float([30, 40])])
    both = dr.select(mono.Bool([True, False]), a, b)
    assert np.array(both.bin).tolist() == [1, 4]
    assert np.array(both.values[0]).tolist() == [10, 40]
