"""Samples go where they are asked for, and every estimate stays right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.cells.sample_shares import FLOOR
from render.errors import RenderError
from render.reference import (
    PRESSED,
    RenderJob,
    SampleAllocation,
    pad_cells,
    render_transport,
    run_job,
    transport_jobs,
)
from render.reference.error_bars import standard_error
from render.scene import Scene, load_scene

PHI = np.array([np.pi / 2, 1.0])
ASKED = np.random.default_rng(5).gamma(0.2, size=(3, 15, 20))
ASKED[0] *= 4.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def jobs_of(scene: Scene, allocation: SampleAllocation, samples: int = 64) -> list[RenderJob]:
    bends = np.array(scene.bending.angles)
    return transport_jobs(
        scene, PHI, bends, samples=samples, per_pass=16, seeds=(1,), allocation=allocation
    )


def test_an_allocation_takes_no_more_samples_and_renders_untouched_pads_only_where_asked(
    scene: Scene,
) -> None:
    usual, pressed = jobs_of(scene, SampleAllocation()), jobs_of(scene, PRESSED)
    assert [job for job in usual if job.indented] == pressed
    told = jobs_of(scene, SampleAllocation(ASKED))
    assert [job.indented for job in told] == [True, False] * 3
    assert [job for job in told if not job.indented] == [job for job in usual if not job.indented]
    found = [job for job in told if job.indented]
    total = sum(job.samples for job in pressed)
    assert sum(job.samples for job in found) == pytest.approx(total, rel=0.01)
    asked = ASKED.sum(axis=(1, 2)) / ASKED.sum()
    shares = [job.samples / total for job in found]
    np.testing.assert_allclose(shares, FLOOR / 3 + (1.0 - FLOOR) * asked, atol=0.01)


def test_more_samples_of_an_allocation_are_more_passes_of_the_same_paths(scene: Scene) -> None:
    few, many = (jobs_of(scene, SampleAllocation(ASKED), samples=n) for n in (16, 80))
    for first, second in zip(few, many, strict=True):
        assert first.slots == second.slots
        assert first.chains == second.chains <= 1.5 * 16384
        assert second.iterations == 5 * first.iterations


@pytest.mark.parametrize(
    "shares", [np.ones((3, 15, 19)), np.ones((2, 15, 20)), -ASKED, np.full(ASKED.shape, np.nan)]
)
def test_impossible_shares_raise_one_clear_error(scene: Scene, shares: np.ndarray) -> None:
    with pytest.raises(RenderError, match=r"allowed: \(3, 15, 20\)") as caught:
        jobs_of(scene, SampleAllocation(shares))
    assert caught.value.field == "allocation"


@pytest.mark.usefixtures("mono")
def test_every_sample_is_divided_by_its_exact_probability(scene: Scene) -> None:
    job = jobs_of(scene, SampleAllocation(ASKED))[0]
    slots = np.array(job.slots)
    cells = pad_cells(scene, np.full((20, 1), 1.0), 0.0, True, slots=slots)
    scale, site, fiber = (np.array(a) for a in (cells._scale, cells._site, cells._fiber))
    expected = np.zeros(slots.shape)
    np.add.at(expected, (site, fiber), scale / len(scale))
    np.testing.assert_allclose(expected, 1.0, rtol=1e-6)


def test_an_allocated_job_travels_and_goes_on_bit_equal(scene: Scene, tmp_path: Path) -> None:
    wanted = SampleAllocation(ASKED, untouched=False)
    job = RenderJob.of(
        scene, np.full((20, 1), 1.0), bend=0.0, indented=True, seed=3, chains=64, iterations=3,
        replicates=4, slots=jobs_of(scene, wanted)[0].slots,
    )  # fmt: skip
    assert RenderJob.from_json(job.to_json()) == job
    state, ticks = tmp_path / "state.npz", list[int]()

    def stop(count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(job, state, stop)
    resumed, unbroken = run_job(job, state, ticks.append), run_job(job)
    assert ticks[0] == job.chains
    np.testing.assert_array_equal(resumed.estimate, unbroken.estimate)


def test_an_unlit_cell_borrows_a_contribution_of_the_size_that_its_samples_give_it() -> None:
    rng, effort = np.random.default_rng(3), np.array([4.0, 4.0, 1.0])[:, None]
    # (replicate, fiber, node, bend, site, facet): contributions of 1 over the samples.
    found = rng.poisson(2.0, (8, 1, 1, 1, 3, 40)) / effort
    found[:, 0, 0, 0, 2] = 0.0
    error = standard_error(found, effort[None, None, None])[0, 0, 0]
    # Of eight replicates, the size of one contribution to the mean is an eighth of that.
    np.testing.assert_allclose(error[2], 1.5 / 8.0, rtol=0.1)
    np.testing.assert_allclose(standard_error(found)[0, 0, 0, 2], 1.5 / 8.0 / 4.0, rtol=0.1)


@pytest.mark.slow
def test_an_allocation_has_no_bias_against_renders_that_share_alike() -> None:
    digit = load_scene("digit")
    shares = np.zeros((1, digit.sites.count, digit.lamp_count))
    shares[0, :4, 0], shares[0, 4:, 1] = 1.0, 0.3
    phi, bends = np.array([np.pi / 2]), np.zeros(1)
    told, usual = (
        render_transport(
            digit, phi, bends, samples=600, seeds=(seed,), replicates=64, allocation=allocation
        )
        for seed, allocation in ((1, SampleAllocation(shares, untouched=False)), (2, PRESSED))
    )
    assert np.isnan(told.background).all()
    # Facets of a site share light paths: their sums under a fiber are independent of each other.
    sums = [found.replicates[:, :, 0, 0].sum(axis=-1) for found in (told, usual)]
    error = np.sqrt(sum(one.var(axis=0, ddof=1) / 64 for one in sums))
    z = (sums[0].mean(axis=0) - sums[1].mean(axis=0)) / error
    # A mirror makes pairs of the sites equal, so some 18 of the 36 are independent.
    assert np.mean(z**2) < 2.0
    assert np.abs(z).max() < 4.0
