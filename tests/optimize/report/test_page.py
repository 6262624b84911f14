"""What reports warn of where previews are less sure than elsewhere."""

from __future__ import annotations

from optimize.report import preview_warnings
from tests.oracles.random_scenes import with_beams


def test_beams_smaller_than_what_previews_tell_apart_are_named() -> None:
    (said,) = preview_warnings(with_beams(13, 1.0), "surrogate", 0.01)
    assert said.startswith("Beams of 0.9 deg") or said.startswith("Beams of 1.0 deg")
    assert "tactilux verify" in said
    assert preview_warnings(with_beams(13, 3.0), "surrogate", 0.01) == []


def test_a_model_that_renders_have_tested_is_not_doubted_for_its_beams() -> None:
    assert preview_warnings(with_beams(13, 1.0), "surrogate", None) == []


def test_noise_beyond_what_photons_were_meant_to_leave_is_named() -> None:
    (said,) = preview_warnings(with_beams(13, 3.0), "surrogate", 0.051)
    assert "noise of 5.1%" in said
