"""The figures show the numbers that they are given, at the place where they belong."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.patches import Circle

from optimize.design import Design, baseline_design, limits_of
from optimize.mounting import mount
from optimize.report import (
    convergence,
    encode_srgb,
    facet_strip,
    png_bytes,
    site_map,
    wiring_drawing,
)
from optimize.search import SearchStep
from render.geometry import flat_sites
from render.scene import Scene, load_scene


def test_srgb_keeps_black_and_white_and_lifts_the_middle() -> None:
    assert encode_srgb(np.array([0.0, 1.0, 2.0, 0.2158605])).tolist() == [0, 255, 255, 128]


def test_every_site_is_written_where_it_lies_on_the_pad(finger20: Scene) -> None:
    metric = np.arange(45.0).reshape(3, 15)
    figure = site_map(finger20, metric, 0.0, 45.0)
    assert [axes.get_title() for axes in figure.axes] == ["bend 0°", "bend 45°", "bend 90°"]
    for axes, values in zip(figure.axes, metric, strict=True):
        written = {text.get_position(): float(text.get_text()) for text in axes.texts}
        expected = {
            tuple(site[:2]): value for site, value in zip(flat_sites(finger20), values, strict=True)
        }
        assert written == expected
        image = axes.images[0]
        left, right, bottom, top = image.get_extent()
        assert bottom < top
        assert left < right
        assert image.get_array()[0, 0] == values[0]


def test_every_facet_has_its_color(finger20: Scene) -> None:
    counts = np.zeros((3, 15, 10, 3))
    counts[1, 4, 7] = [255, 0, 0]
    figure = facet_strip(finger20, counts)
    colors = figure.axes[1].collections[0].get_facecolor()
    assert np.argwhere(colors[:, 0] == 1.0).ravel().tolist() == [4 * 10 + 7]


def test_equal_content_gives_equal_bytes(finger20: Scene) -> None:
    counts = np.zeros((3, 15, 10, 3))
    pictures = [png_bytes(facet_strip(finger20, counts)) for _ in range(2)]
    assert pictures[0] == pictures[1]
    assert pictures[0].startswith(b"\x89PNG")


def test_the_convergence_plot_has_one_mark_for_every_step(finger20: Scene) -> None:
    design = baseline_design(finger20)
    stages = ["start", "grouped", "quick", "tied", "free", "quick", "tied", "free"]
    steps = [
        SearchStep(design, 10.0 + number, 1, stage, 10**number, 1.0 + number)
        for number, stage in enumerate(stages)
    ]
    lines = convergence(steps).axes[0].lines
    marked = sorted(float(x) for line in lines[1:] for x in np.asarray(line.get_xdata()))
    assert marked == [step.seconds for step in steps]


def test_drawn_beams_of_neighbors_never_cross_and_labels_stay_clear(finger20: Scene) -> None:
    limits, rng = limits_of(finger20), np.random.default_rng(6)
    phi = limits.nearest_directions(rng.uniform(0.0, np.pi, 20))
    design = Design.of_colors(phi, np.arange(20) % 3)
    axes = wiring_drawing(mount(finger20, design, step=0.0)).axes[0]
    arrows = [np.array([note.xyann, note.xy]) for note in axes.texts if hasattr(note, "xyann")]
    beams, (x, y) = arrows[2:], arrows[:2]
    assert [x[0].tolist(), y[0].tolist()] == [[0.0, 0.0], [0.0, 0.0]]
    assert x[1][0] > 0 == x[1][1]
    assert y[1][1] > 0 == y[1][0]
    assert len(beams) == 20
    for first, second in pairwise(beams):
        reach = np.linalg.norm(first[1] - first[0]) + np.linalg.norm(second[1] - second[0])
        assert reach < np.linalg.norm(first[0] - second[0])
    labels = {text.get_text(): np.array(text.get_position()) for text in axes.texts
              if text.get_text().isdigit()}  # fmt: skip
    assert sorted(map(int, labels)) == list(range(20))
    for place in labels.values():
        for start, end in beams:
            along = np.clip(np.dot(place - start, end - start) / np.sum((end - start) ** 2), 0, 1)
            assert np.linalg.norm(place - start - along * (end - start)) > 1.0


def test_lamps_under_the_pad_are_drawn_as_disks_where_they_are() -> None:
    scene = load_scene("gelsight-flat")
    axes = wiring_drawing(mount(scene, baseline_design(scene), step=0.0)).axes[0]
    disks = [patch for patch in axes.patches if isinstance(patch, Circle)]
    lamps = scene.placed_lamps()
    assert len(disks) == len(lamps) == 24
    for disk, lamp in zip(disks, lamps, strict=True):
        assert disk.center == pytest.approx(lamp.position[:2])
        assert disk.radius == pytest.approx(lamp.diameter / 2)
    # Beside sites, axes and origin there are no lines: nothing is laid flat.
    assert len(axes.lines) == 3
