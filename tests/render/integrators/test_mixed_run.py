"""Plain samples and chains in one run: who gets the work, and what comes of it."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.render.integrators.test_bidirectional import lambert, plane, sensor

pytestmark = pytest.mark.slow

REPLICATES = 8


@pytest.fixture
def small(mono: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pilots be made in runs of a few thousand samples, with some hundred chains.

    As if passes cost nothing besides their mutations, or no pilot would pay.
    """
    from render.integrators import mixed_run

    monkeypatch.setattr(mixed_run, "PILOT_MIN", 1 << 14)
    monkeypatch.setattr(mixed_run, "LANES", 1 << 14)
    monkeypatch.setattr(mixed_run, "PASS_COST", 0)


def run(scene: Any, spp: int, seed: int = 1, chains: int = 4096) -> tuple[Any, np.ndarray]:
    """Return a mixed run and its images ``(replicate, pixel, channel)``."""
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.mixed_run import MixedRun
    from render.integrators.subpaths import PathLimits
    from render.sampling.pssmlt import ChainSettings

    sampler = FilmSampler(scene, scene.sensors()[0], PathLimits())
    settings = ChainSettings(chains, 16384, 0.3, REPLICATES, seed)
    mixed = MixedRun(sampler, settings, spp * sampler.bins)
    return mixed, mixed.sample()


def assert_brightness_is_that_of_bdpt(mixed: Any, images: np.ndarray, most: float) -> None:
    """Hold the mean to that of plain samples of another seed; its error is below ``most`` of it."""
    from render.integrators.vertex_cache import SHARED_PATHS
    from render.sampling.monte_carlo import monte_carlo_replicates

    truth = monte_carlo_replicates(
        mixed.sampler.sharing(1 << 18, REPLICATES, SHARED_PATHS), lanes=1 << 18, passes=2,
        replicates=REPLICATES, seed=7,
    )  # fmt: skip
    ours, others = (x.mean(axis=(1, 2)) for x in (images, truth))
    bar = np.hypot(ours.std(ddof=1), others.std(ddof=1)) / np.sqrt(REPLICATES)
    assert abs(ours.mean() - others.mean()) < 4 * bar
    assert bar < most * others.mean()


def under_glass(mono: ModuleType) -> Any:
    """Return a floor under a smooth pane, lit by a small disk: only a lucky camera finds it."""
    transform = mono.ScalarTransform4f()
    black = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}
    return mono.load_dict(
        {
            "type": "scene",
            "sensor": sensor(mono, [0, 0, 4]),
            "floor": {
                "type": "rectangle", "to_world": transform.scale(9), "bsdf": {"type": "diffuse"},
            },
            "pane": {
                "type": "cube", "to_world": transform.translate([0, 0, 0.5]).scale([9, 9, 0.2]),
                "bsdf": {"type": "dielectric"},
            },
            "lamp": {
                "type": "disk", "bsdf": black,
                "to_world": transform.translate([0, 3, 2.5]).rotate([1, 0, 0], 180).scale(0.5),
                "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 90.0}},
            },
        }
    )  # fmt: skip


def test_a_run_too_short_for_a_pilot_is_that_of_bdpt_bit_for_bit(mono: ModuleType) -> None:
    scene = plane(mono)
    image, plain = (
        np.array(mono.load_dict({"type": kind}).render(scene, seed=5, spp=64))
        for kind in ("pssmlt", "bdpt")
    )
    np.testing.assert_array_equal(image, plain)


@pytest.mark.usefixtures("small")
def test_where_plain_samples_do_well_chains_get_no_more_than_their_pilot_and_count_nothing(
    mono: ModuleType,
) -> None:
    from render.integrators.mixed_run import PILOT_MUTATIONS

    mixed, images = run(plane(mono), 2048)
    assert mixed.chains is not None
    assert mixed.chains.done == PILOT_MUTATIONS
    assert mixed.chain_share() < 0.1
    np.testing.assert_array_equal(images, mixed.plain.estimate())
    error = images.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    score = np.abs(images.mean(axis=0)[:, 0] - lambert().ravel()) / error[:, 0]
    assert (score < 2.365).mean() > 0.85


@pytest.mark.usefixtures("small")
def test_short_chains_that_have_not_seen_the_rare_light_get_no_more_than_their_pilot(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.integrators import mixed_run
    from render.integrators.mixed_run import PILOT_MUTATIONS

    mixed, images = run(under_glass(mono), 16384)
    assert mixed.chains is not None
    monkeypatch.setattr(mixed_run, "variance_apart", lambda *_: 0.0)
    plain, _, whole = mixed._variances()
    # They look less than half as inefficient as plain samples, by what they have seen.
    assert whole * mixed._chain_work() < 0.5 * plain * mixed.plain_samples()
    assert mixed.chains.done == PILOT_MUTATIONS
    np.testing.assert_array_equal(images, mixed.plain.estimate())
    assert_brightness_is_that_of_bdpt(mixed, images, 0.1)


@pytest.mark.usefixtures("small")
def test_where_chains_are_carried_on_the_picture_is_that_of_bdpt(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.integrators.mixed_run import CHAINS_FRACTION, PILOT_MUTATIONS, MixedRun

    monkeypatch.setattr(MixedRun, "_chains_pay", lambda *_: True)
    mixed, images = run(under_glass(mono), 16384)
    assert mixed.chains is not None
    assert mixed.chains.done > PILOT_MUTATIONS
    assert mixed.chain_share() <= CHAINS_FRACTION
    assert_brightness_is_that_of_bdpt(mixed, images, 0.15)


def test_an_inefficiency_grows_with_every_doubling_as_with_the_last_one() -> None:
    from render.integrators.mixed_run import final_inefficiency

    # A variance that halves: samples are as good as independent.
    assert final_inefficiency(2.0, 1.0, work=10, total=1000) == pytest.approx(10)
    # One that stays: what is rare was not seen yet.
    assert final_inefficiency(1.0, 1.0, work=10, total=80) == pytest.approx(80)
    # With a variance in proportion to the work to the power of -0.5.
    assert final_inefficiency(2**0.5, 1.0, work=10, total=1000) == pytest.approx(100)


def test_what_no_chain_has_met_is_in_their_variance_by_their_distance_from_plain_samples() -> None:
    from render.integrators.mixed_run import variance_apart

    # Of 100 samples in each of 8 replicates one in 10,000 is 10,000, all others 0.
    rng = np.random.default_rng(1)
    chains = 1e4 * rng.binomial(100, 1e-4, (20_000, 8, 1)) / 100
    plain = 1 + 0.1 * rng.standard_normal(chains.shape)
    found = np.array([variance_apart(*pair) for pair in zip(plain, chains, strict=True)])
    bar = found.std() / np.sqrt(len(found))
    assert bar < 5
    assert abs(found.mean() - 1e8 * 1e-4 * (1 - 1e-4) / 100) < 4 * bar
    unmet = (chains == 0).all(axis=(1, 2))
    assert unmet.mean() > 0.9
    # Replicates that agree on 0 say that their variance is 0; it is seen to be 8 times the square.
    assert found[unmet].mean() == pytest.approx(8, abs=0.1)


@pytest.mark.usefixtures("small")
def test_a_pilot_takes_its_part_of_the_work_with_what_its_passes_cost(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.integrators import mixed_run

    monkeypatch.setattr(mixed_run, "PASS_COST", 100)
    mixed, _ = run(plane(mono), 2048)
    assert mixed.chains is not None
    assert mixed.chains.done == mixed_run.PILOT_MUTATIONS
    passes = mixed_run.PILOT_MUTATIONS + mixed_run.STARTS_PER_CHAIN + 1
    assert mixed._chain_work() >= passes * 100
    assert 0.9 < mixed._chain_work() / (mixed_run.PILOT_FRACTION * mixed.paths) <= 1.0


@pytest.mark.usefixtures("small")
def test_a_seed_divides_the_work_in_the_same_way_again(mono: ModuleType) -> None:
    scene = under_glass(mono)
    (first, image), (second, again) = (run(scene, 1024, seed=3) for _ in range(2))
    assert first.chain_share() == second.chain_share()
    np.testing.assert_array_equal(image, again)


@pytest.mark.usefixtures("small")
def test_without_light_in_the_bootstrap_plain_samples_go_on_alone(mono: ModuleType) -> None:
    scene = plane(mono, light={"type": "point", "position": [0, 0, -1], "intensity": 3.0})
    mixed, images = run(scene, 512)
    assert mixed.chains is None
    assert (images == 0).all()
