"""Samples of a render follow what moves the scores of its designs."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.verification import allocation_of, score_allocation
from optimize.verification.score_allocation import allocation_digest
from render.geometry import mirror_image
from render.reference import EVERYTHING, PRESSED
from render.scene import Scene
from render.transport import TransportTable


def settings_of(table: TransportTable) -> ScoreSettings:
    return ScoreSettings(table.exposure, table.lam)


def designs_of(small: Scene) -> list[Design]:
    base = baseline_design(small)
    turned = Design(np.linspace(0.9, 2.2, small.lamp_count), base.power)
    return [base, turned, Design.of_colors(turned.phi, np.arange(small.lamp_count) % 3)]


def slopes(table: TransportTable, design: Design) -> np.ndarray:
    """Return what relative changes of single cells do to S, by differences: ``(F, B, S, K)``."""
    settings, light = settings_of(table), table.at(design.phi)
    found, h = np.zeros(light.shape), 1e-4
    for cell in np.ndindex(*light.shape):
        moved = []
        for factor in (1.0 + h, 1.0 - h):
            changed = light.copy()
            changed[cell] *= factor
            moved.append(float(settings.parts(changed, design.power)[0]))
        found[cell] = (moved[0] - moved[1]) / (2.0 * h)
    return found


def test_no_other_shares_give_less_variance_of_independent_relative_noise(
    small: Scene, table: TransportTable
) -> None:
    _, turned, other = designs_of(small)
    found = score_allocation(small, table, settings_of(table), [turned, other])
    assert found.shares is not None
    lead, rival = slopes(table, turned), slopes(table, other)
    # Variance of one sample of a pair: the leader's score and the difference to the other, each
    # in units of the least that it can have.
    parts = [(slope**2).sum(axis=-1).transpose(1, 2, 0) for slope in (lead, rival - lead)]
    wanted = np.sum([part / np.sqrt(part).sum() ** 2 for part in parts], axis=0)

    def variance(shares: np.ndarray) -> float:
        return float((wanted / (shares / shares.sum())).sum())

    least = variance(found.shares)
    # The closed form: the squared sum of the standard deviations (Neyman 1934).
    assert least == pytest.approx(np.sqrt(wanted).sum() ** 2, rel=1e-3)
    rng = np.random.default_rng(2)
    for size in (0.03, 0.3):
        changed = found.shares * np.exp(size * rng.standard_normal(found.shares.shape))
        assert variance(changed) > least
    assert variance(np.ones(wanted.shape)) > 1.2 * least


def test_a_lamp_that_no_design_lights_gets_the_floor_alone(
    small: Scene, table: TransportTable
) -> None:
    dark = [Design(one.phi, one.power * (np.arange(8) != 3)[:, None]) for one in designs_of(small)]
    found = score_allocation(small, table, settings_of(table), dark, leader=1)
    assert found.shares is not None
    assert not found.shares[..., 3].any()
    assert found.shares[..., np.arange(8) != 3].min() > 0.0


def test_designs_that_do_not_matter_move_no_samples(small: Scene, table: TransportTable) -> None:
    base, turned, other = designs_of(small)
    settings = settings_of(table)
    alone = score_allocation(small, table, settings, [turned])
    among = score_allocation(small, table, settings, [base, turned, other], leader=1, rivals=())
    np.testing.assert_array_equal(alone.shares, among.shares)
    every = score_allocation(small, table, settings, [base, turned, other], leader=1)
    assert not np.allclose(alone.shares, every.shares)


def test_a_symmetric_sensor_gets_symmetric_samples_for_any_colors(
    small: Scene, table: TransportTable
) -> None:
    base = baseline_design(small)
    lopsided = Design.of_colors(base.phi, np.array([0, 0, 1, 1, 1, 2, 1, 2]))
    found = score_allocation(small, table, settings_of(table), [base, lopsided], leader=1)
    assert found.shares is not None
    cells = found.shares.transpose(2, 0, 1)[:, None]  # (fiber, node, bend, site)
    np.testing.assert_allclose(mirror_image(small, cells, facets=False), cells, rtol=1e-6)


def test_a_record_keeps_an_allocation_to_the_bit(small: Scene, table: TransportTable) -> None:
    found = score_allocation(small, table, settings_of(table), designs_of(small), untouched=True)
    assert found.shares is not None
    content = json.loads(json.dumps(asdict(found) | {"shares": found.shares.tolist()}))
    kept = allocation_of(content)
    np.testing.assert_array_equal(kept.shares, found.shares)
    assert kept.untouched
    assert allocation_digest(kept) == allocation_digest(found)
    assert allocation_of(None) is EVERYTHING
    assert len({allocation_digest(one) for one in (kept, EVERYTHING, PRESSED)}) == 3


def test_without_a_model_samples_are_shared_as_usual(small: Scene) -> None:
    settings = ScoreSettings(1.0, 1.0)
    assert score_allocation(small, None, settings, designs_of(small)) is PRESSED
    assert score_allocation(small, None, settings, designs_of(small), untouched=True).untouched
