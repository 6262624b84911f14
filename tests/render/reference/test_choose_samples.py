"""In how many passes so many samples are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from render.cells.choose_sampler import STRATA
from render.reference import transport_jobs
from render.reference.choose_samples import shared_shape
from tests.oracles.pads import scene_of_case


def test_replicates_have_the_same_samples_and_passes_the_same_paths() -> None:
    scene = scene_of_case("smooth")
    for samples in (1, 100, 5000, 400_000):
        lanes, passes = shared_shape(scene, samples, 8, None, indented=True)
        assert lanes % 8 == 0
        wanted = max(samples, STRATA * 8)
        assert STRATA * lanes * passes == pytest.approx(wanted, rel=0.35)
    lanes, passes = shared_shape(scene, 7 * 96, 8, 96, indented=True)
    assert (lanes, passes) == (24, 7)


def test_a_render_of_more_passes_goes_on_from_one_of_fewer_and_has_a_key_of_its_own() -> None:
    scene = scene_of_case("smooth")
    phi, bends = np.array([1.2]), np.zeros(1)
    few, many = (
        transport_jobs(scene, phi, bends, samples=n * 64, per_pass=64, seeds=(1,)) for n in (1, 3)
    )
    for one, other in zip(few, many, strict=True):
        assert one.chains == other.chains
        assert other.iterations == 3 * one.iterations
    assert few[0].key != replace(few[0], sampler="pssmlt").key
