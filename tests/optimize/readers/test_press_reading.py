"""Depth is read from drawn pictures where it is, as well as noise and the indenter's cone allow."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.readers import CameraModel
from optimize.readers.press_reading import (
    HEIGHTS,
    ExposedDesign,
    PressedPad,
    PressReader,
    detected,
    read_press,
)
from render.errors import SceneError
from render.geometry import HeightMap, probe
from render.scene import Scene, load_scene, unchecked


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Return gelsight-mini with a quarter of its pixels."""
    mini = load_scene("gelsight-mini")
    return unchecked(mini, {"camera": unchecked(mini.camera, {"columns": 120, "rows": 160})})


@pytest.fixture(scope="module")
def pad(scene: Scene) -> PressedPad:
    """Return it under its baseline, so bright that hardly a pixel saturates."""
    light = ExposedDesign(baseline_design(scene), 1.0, 1.0)
    unlit = PressedPad(scene, [light], 1.0)
    brightest = np.quantile(unlit.pictures(HeightMap(np.zeros((2, 2)), 1.0, 1.0))[0], 0.998)
    return PressedPad(scene, [light], 255.0 / brightest)


@pytest.fixture(scope="module")
def two_caps(pad: PressedPad) -> HeightMap:
    """Return a skin with no symmetry."""
    deep = pad.caps(np.array([[2.0, 4.0]]), 3.0, 0.3).depth
    shallow = pad.caps(np.array([[-3.0, -2.0]]), 2.0, 0.15).depth
    return HeightMap(np.maximum(deep, shallow), pad.scene.pad.width, pad.scene.pad.length)


@pytest.fixture(scope="module")
def readers(pad: PressedPad) -> dict[float, PressReader]:
    """Return a reader for each read noise."""
    lesson = pad.lesson()
    return {noise: PressReader(pad, lesson, 0, CameraModel(noise), 0) for noise in (0.5, 1.0, 4.0)}


def test_a_taught_reader_finds_balls_where_they_are_and_as_deep_as_they_are(
    pad: PressedPad, two_caps: HeightMap, readers: dict[float, PressReader]
) -> None:
    reader, counts = readers[1.0], pad.pictures(two_caps)[0]
    slopes, cut = reader.slopes(reader.recorded(counts))
    depth = reader.depth(slopes)
    assert np.nanmax(depth) == pytest.approx(0.3, abs=0.04)
    row, column = np.unravel_index(np.nanargmax(depth), depth.shape)
    np.testing.assert_allclose([pad.x[column], pad.y[row]], [2.0, 4.0], atol=0.4)
    shallow = np.where(pad.y[:, None] < 0.0, depth, np.nan)
    assert np.nanmax(shallow) == pytest.approx(0.15, abs=0.03)
    off = (depth - two_caps.depth)[two_caps.depth > 0]
    assert np.sqrt(np.nanmean(off**2)) < 0.03
    assert cut.mean() < 1e-3


def test_slopes_that_are_read_are_those_of_the_skin_at_each_pixel(
    pad: PressedPad, two_caps: HeightMap, readers: dict[float, PressReader]
) -> None:
    from render.preview import Preview

    reader, counts = readers[1.0], pad.pictures(two_caps)[0]
    with Preview(pad.scene, imprint=two_caps) as preview:
        sight = preview.sight(0.0, *pad.size)
    read = reader.slopes(reader.recorded(counts))[0][:, ::-1].reshape(2, -1)[:, sight.pixel]
    true = (sight.facing[:, :2] / sight.facing[:, 2:]).T
    pressed = np.linalg.norm(true, axis=0) > 0.05
    off = np.degrees(np.linalg.norm(read - true, axis=0))[pressed]
    assert np.median(off) < 2.5
    for one, other in zip(read, true, strict=True):
        assert np.corrcoef(one[pressed], other[pressed])[0, 1] > 0.97


@pytest.mark.slow
def test_a_noisier_camera_sees_more_of_nothing_and_a_ball_as_well(
    pad: PressedPad, readers: dict[float, PressReader], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.readers.press_reading.FALSE_PEAKS", 15)
    false = [readers[noise].false_peak() for noise in (0.5, 1.0, 4.0)]
    assert false == sorted(false)
    counts = pad.pictures(pad.small_ball(0.064))[0]
    peaks = [np.median(readers[noise].peaks(counts, 4)) for noise in (0.5, 4.0)]
    np.testing.assert_allclose(peaks, 0.064, atol=0.02)


def test_the_smallest_ball_is_where_its_peak_crosses_that_of_nothing() -> None:
    assert detected(lambda depth: max(depth, 0.003), 0.005) == pytest.approx(5.0)
    assert detected(lambda depth: 2.0 * depth, 0.03) == pytest.approx(15.0)
    assert detected(lambda depth: depth, 0.0) == 1000.0 * HEIGHTS[0]
    assert detected(lambda depth: depth, 1.0) is None


@pytest.mark.slow
def test_figures_say_how_much_of_a_press_is_steeper_than_the_indenter(
    pad: PressedPad, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.readers.press_reading.FALSE_PEAKS", 15)
    edge = probe(pad.scene, "edge", 0.4, 0.3)
    assert edge is not None
    quiet, noisy = (
        read_press(pad.scene, edge, pad.lights, pad.exposure, CameraModel(noise), 0)[0]
        for noise in (0.5, 6.0)
    )
    assert min(quiet.clipped, noisy.clipped) > 0.02
    assert 5.0 < quiet.depth_rms_um < quiet.depth_worst_um
    assert quiet.detected_um is not None
    assert noisy.detected_um is not None
    assert quiet.detected_um < noisy.detected_um
    assert quiet.recovered.shape == quiet.true.shape == (len(pad.y), len(pad.x))


def test_a_curved_skin_is_refused() -> None:
    dome = load_scene("digit-dome")
    with pytest.raises(SceneError, match="curved skin, allowed"):
        PressedPad(dome, [], 1.0)
