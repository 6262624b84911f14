"""Contrast of real sensors: a picture that is turned and dimmed is found again; the Mini holds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import tactilux

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import contrast
from contrast import SENSORS, Array, encoded, figures, fitted, harmonic, laid, measured


@pytest.fixture(scope="module")
def digit() -> Array:
    return measured("digit")


def test_the_tables_have_three_places_each_way_and_the_contrast_that_their_page_says(
    digit: Array,
) -> None:
    assert digit.shape == (3, 3, 3, 24, 3)
    assert np.abs(digit[:, :, 1]).mean(axis=(0, 1, 2)) == pytest.approx([31, 19, 42], abs=0.5)
    mini = np.abs(measured("gelsight_mini")[:, :, 1]).mean(axis=(0, 1, 2))
    assert mini == pytest.approx([25, 19, 29], abs=0.7)


@pytest.mark.parametrize("number", [0, 3, 7, 12])
def test_a_picture_that_lies_otherwise_with_other_gains_is_found_again(
    digit: Array, number: int
) -> None:
    turned = list(laid(digit))[number] * [0.5, 3.0, 0.1]
    found = fitted(turned[..., ::-1], digit, ((0, 1, 2), (2, 1, 0)))
    np.testing.assert_allclose(harmonic(found), harmonic(digit), atol=1e-9)
    assert max(map(abs, figures(found, digit).values())) < 1e-9


def test_a_picture_turned_by_a_quarter_fails_by_its_azimuth(digit: Array) -> None:
    turned = np.roll(digit, 6, axis=3)
    assert figures(turned, digit)["brightest azimuth, deg"] == pytest.approx(90.0)


def test_encoding_makes_bright_facets_of_a_dark_pad_stand_out_as_a_root_does() -> None:
    facets, untouched = np.full((1, 1, 1, 24, 3), 4.0), np.full((1, 1, 3), 1.0)
    np.testing.assert_allclose(encoded((facets, untouched), 2.0), 1.0)
    np.testing.assert_allclose(encoded((facets, untouched), 1.0), 3.0)


@pytest.mark.slow
def test_a_gelsight_mini_reads_and_shades_as_it_was_measured() -> None:
    sensor, scene = SENSORS["gelsight-mini"], tactilux.load_scene("gelsight-mini")
    seen = contrast.predicted(scene, sensor.pixel, contrast.previewed)
    real = measured(sensor.table)
    found = figures(fitted(encoded(seen, contrast.ENCODING), real, sensor.orders), real)
    for what, goal in contrast.GOALS.items():
        assert abs(found[what]) <= goal, what


def test_a_sensor_nobody_measured_is_told_which_were(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        contrast.main(["omnitact=digit"])
    assert "allowed: one of digit, gelsight-mini" in capsys.readouterr().err
