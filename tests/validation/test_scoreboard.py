"""The scoreboard calls worse what is worse, and nothing else."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import stats

from tests.oracles.kept_photons import SENSORS, WHOLE, photons_kept
from tests.validation.scoreboard import KEPT, LEVELS, SLABS, Cells, Row, judged, read_row
from tests.validation.scoreboard import held_against_photons as held

PAD = Row(
    "smooth", "reference", facets=(1.001, 0.002), sites=(0.999, 0.003), off=0.01, rms_z=1.0,
    held=(0.95, 400), variance=1e-4, seconds=10.0, first=3.0, memory=300.0,
)  # fmt: skip


def test_a_row_is_not_worse_than_itself_and_comes_back_from_its_file() -> None:
    assert not judged(PAD, PAD)
    assert read_row(json.loads(json.dumps(asdict(PAD)))) == PAD


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"facets": (0.97, 0.002)}, "facets"),
        ({"sites": (1.03, 0.003)}, "sites"),
        ({"held": (0.85, 400)}, "held"),
        ({"seconds": 31.0}, "cost"),
        ({"variance": 4e-4}, "cost"),
        ({"refused": "no light"}, "was"),
    ],
)
def test_a_row_that_has_become_worse_is_told(change: dict[str, object], word: str) -> None:
    (fault,) = judged(replace(PAD, **change), PAD)  # type: ignore[arg-type]
    assert fault.startswith(word)


def test_a_row_may_move_within_its_error_bars_and_towards_the_truth() -> None:
    assert not judged(replace(PAD, facets=(0.993, 0.003)), PAD)
    assert not judged(PAD, replace(PAD, facets=(0.9, 0.002)))


def test_shipped_scenes_may_become_a_third_dearer_and_pads_three_times() -> None:
    dearer = replace(PAD, seconds=2.0 * PAD.seconds)
    assert not judged(dearer, PAD)
    shipped = replace(PAD, scene="shipped digit")
    assert judged(replace(dearer, scene="shipped digit"), shipped)


def test_cells_as_photons_have_them_are_right_and_those_without_a_lamp_are_not() -> None:
    truth = [photons_kept("smooth", pressed) for pressed in (True, False)]
    rng = np.random.default_rng(0)

    def redrawn(lamps: slice) -> Row:
        targets = []
        for one in truth:
            cells = one.copy()
            cells[:, lamps] = 0.0
            cells = cells.reshape(len(one), -1)
            se = stats.sem(one.reshape(len(one), -1))
            drawn = cells.mean(axis=0) + 4.0 * se * rng.standard_normal((16, len(se)))
            targets.append((drawn, drawn.std(axis=0, ddof=1) / 4.0))
        return held("smooth", "reference", Cells(tuple(targets), 1.0, 1.0))

    right, wrong = redrawn(slice(0)), redrawn(slice(0, 1))
    assert right.facets is not None
    assert abs(right.facets[0] - 1.0) < 4.0 * right.facets[1]
    assert right.rms_z is not None
    assert right.rms_z < 1.3
    assert {fault.split()[0] for fault in judged(wrong, right)} >= {"facets", "sites", "held"}


def test_rows_on_record_are_of_the_table_and_right() -> None:
    """What is kept is what changes are held against: no row of it may be far off itself."""
    rows = [read_row(one) for rows in json.loads(KEPT.read_text()).values() for one in rows]
    assert len(rows) > 30
    for row in rows:
        assert row.scene in (*SENSORS, *WHOLE, *SLABS)
        assert row.level in LEVELS
        for ratio, error in (row.facets or (1.0, 0.0), row.sites or (1.0, 0.0)):
            assert abs(ratio - 1.0) < 4.0 * error + 0.01
