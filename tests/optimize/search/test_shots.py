"""Searches over shots: against brute force, and three pictures against three colors."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, SearchLimits, turning_limits, unlimited
from optimize.objectives import READERS, ReaderName
from optimize.readers import CameraModel
from optimize.scoring import TableScorer
from optimize.search import ReaderObjective, refine_by
from optimize.search.colors import exact_colors, grouped_colors, quick_colors
from render.chebyshev import chebyshev_nodes
from render.scene import Scene, unchecked
from render.scene.colors import LedColor, palette_of
from render.transport import TransportTable
from tests.small_scenes import small_scene

MakeTable = Callable[..., TransportTable]
BENDS = {"value": [0.0], "unit": "deg", "source": "test"}


def two_shots(counts: tuple[int, ...]) -> SearchLimits:
    return replace(unlimited(4, palette_of(None, None, 2)), led_counts=np.array(counts))


@pytest.mark.parametrize("counts", [(4, 4, 4), (1, 2, 1), (2, 2, 0)])
def test_searches_of_colors_equal_brute_force_over_all_shots(
    make_table: MakeTable, counts: tuple[int, ...]
) -> None:
    limits = two_shots(counts)
    scorer = TableScorer(make_table(4, 3, 1, 3, 5), limits=limits)
    phi = scorer.at_node(1)
    every = np.array(list(itertools.product(range(9), repeat=4)))
    best = scorer.scores(every[limits.fits(every)], phi).max()
    assert exact_colors(scorer, phi).score == pytest.approx(best)
    assert quick_colors(scorer, phi).score == pytest.approx(best, rel=1e-3)
    if 1 not in counts:  # neighbors in pairs need LEDs in pairs
        found = grouped_colors(scorer, phi)
        assert limits.fits(found.colors[None])[0]
        assert found.score <= best * (1 + 1e-12)


def three_lamps() -> Scene:
    return small_scene(fibers={"left": 1, "tip": 1, "right": 1}, bending={"angles": BENDS})


def gray(scene: Scene, shots: int) -> Scene:
    """Return ``scene`` with white LEDs and a gray camera that takes so many shots."""
    camera = unchecked(scene.camera, {"channels": ("gray",), "shots": shots})
    white = LedColor.model_construct(name="white", response=(1.0,), ink=None)
    return unchecked(scene, {"colors": (white,), "camera": camera})


def lambertian_table(scene: Scene) -> TransportTable:
    """Return what lamps of a slant add to a Lambertian plane; phi is the azimuth of each."""
    faces, slope, slant = scene.indenter.faces, np.sin(scene.indenter.slope), 0.6
    phi = chebyshev_nodes(17, 0.0, np.pi)
    facets = 2 * np.pi * np.arange(faces) / faces
    shade = 1.0 + slope * np.tan(slant) * np.cos(facets - phi[:, None])
    cells = (len(scene.state_axis), scene.sites.count)
    light = np.broadcast_to(
        shade[None, :, None, None], (scene.lamp_count, len(phi), *cells, faces)
    ).copy()
    pad = np.ones(light.shape[:-1])
    return TransportTable(light, 0.0 * light, phi, 100.0, 0.0, background=pad)


@pytest.mark.parametrize("longest", [4.0, 0.5])
@pytest.mark.parametrize("reader", READERS)
def test_three_gray_shots_of_a_lamp_each_are_three_colors(
    reader: ReaderName, longest: float
) -> None:
    colored = three_lamps()
    shots, table = gray(colored, 3), lambertian_table(colored)
    camera = CameraModel(longest_exposure=longest, full_well=1e5)
    # A third of the time each, made up for by a camera that counts every photon three times.
    sensitive = replace(camera, shots=3, full_well=3e5, read_noise=camera.read_noise / 3)
    one, three = (
        ReaderObjective(TableScorer(table, limits=turning_limits(scene)), scene, reader, known)
        for scene, known in ((colored, camera), (shots, sensitive))
    )
    rng = np.random.default_rng(7)
    names = ["white@1", "white@2", "white@3"]
    for colors in itertools.permutations(range(3)):
        phi = rng.uniform(0.0, np.pi, 3)
        in_turn = [shots.palette.index(names[color]) for color in colors]
        degrees = one.value(Design.of_colors(phi, colors))
        assert three.value(Design.of_colors(phi, in_turn, shots.palette)) == pytest.approx(degrees)
        # All lamps in all shots are one brightness: a guess.
        every = Design.of_colors(phi, [0, 0, 0], shots.palette)
        assert three.value(every) < degrees - 5.0


@pytest.mark.parametrize("reader", READERS)
def test_lamps_of_three_shots_turn_120_degrees_apart(reader: ReaderName) -> None:
    # Spence and Chantler (2006): three pictures under one lamp each, over a Lambertian plane.
    shots = gray(
        small_scene(fibers={"left": 1, "tip": 1, "right": 1}, bending={"angles": BENDS}), 3
    )
    scorer = TableScorer(lambertian_table(shots), limits=turning_limits(shots))
    goal = ReaderObjective(scorer, shots, reader, CameraModel(0.3, full_well=1e12, shots=3))
    in_turn = [shots.palette.index(f"white@{shot}") for shot in (1, 2, 3)]
    start = Design.of_colors(np.array([0.4, 1.2, 2.9]), in_turn, shots.palette)
    found = refine_by(scorer, goal, start)
    # A lamp and the one across from it tell the same of a known albedo: axes are 60 deg apart.
    apart = np.radians([0.0, 60.0, 120.0])
    exact = [replace(start, phi=apart + turn) for turn in np.radians([0.0, 15.0, 30.0, 45.0])]
    assert found.score == pytest.approx(goal.values(exact).max(), abs=0.02)
    assert found.score > goal.value(start) + 0.02
    if reader == "sensor":  # whose normals are spread alike over all azimuths
        between = np.diff(np.sort(np.append(found.design.phi, found.design.phi.min() + np.pi)))
        assert np.degrees(between) == pytest.approx(60.0, abs=6.0)
