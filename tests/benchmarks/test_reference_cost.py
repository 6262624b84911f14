"""What a facet color costs at level 2, against simpler renderers: squared error times seconds.

Cost = squared relative error (pooled over all facets: sum of variances over sum of squared means)
x processor seconds over two cores; it does not depend on how long a renderer runs. The colors
are those of finger20 with all fibers lit, flat. A renderer that has not yet seen its rare bright
paths looks better than it is: the ratios for the simpler ones are lower bounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.chebyshev import chebyshev_nodes
from render.reference import pad_cells
from render.scene import Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case
from tests.validation.test_slab_reference import COATED, blocks, lamp, slab

REPLICATES = 16
CORES = 2


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def problem(scene: Scene, nodes: np.ndarray, bend: float = 0.0) -> Any:
    phi = np.tile(nodes, (scene.lamp_count, 1))
    return pad_cells(scene, phi, bend, indented=True)


def cost(draw: Callable[[int, int], np.ndarray], passes: int) -> tuple[float, float, float]:
    """Return cost, brightness and its standard error, from replicates of a seed and some passes."""
    # Kernels are compiled in the first pass.
    draw(1, 1)
    began = time.process_time()
    replicates = draw(2, passes)
    seconds = (time.process_time() - began) / CORES
    mean = replicates.mean(axis=0)
    variance = replicates.var(axis=0, ddof=1) / len(replicates)
    total = replicates.sum(axis=1)
    return (
        float(variance.sum() / (mean**2).sum() * seconds),
        float(total.mean()),
        float(total.std(ddof=1) / np.sqrt(len(total))),
    )


def test_the_cost_of_facet_colors(
    mono: ModuleType, scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    from render.optics.lit_scene import lit_scene
    from render.sampling.monte_carlo import monte_carlo_replicates
    from tests.benchmarks.plain_renderers import by_light_tracing, by_volpath

    cells = problem(scene, np.array([np.pi / 2]))
    camera, fibers = scene.camera, scene.lamp_count
    lit = lit_scene(
        scene, np.full(fibers, np.pi / 2), np.ones(fibers), 0.0,
        width=camera.columns, height=camera.rows,
    )  # fmt: skip

    def ours(seed: int, passes: int) -> np.ndarray:
        found = monte_carlo_replicates(
            cells, lanes=8192, passes=passes, replicates=REPLICATES, seed=seed
        )
        return found.reshape(REPLICATES, fibers, -1).sum(axis=1)

    rows = {
        "cells (ours)": cost(ours, 8),
        "light tracer": cost(
            lambda s, n: by_light_tracing(scene, lit, cells.targets, n, REPLICATES, s), 8
        ),
        "volpath": cost(lambda s, n: by_volpath(scene, lit, cells.targets, n, REPLICATES, s), 6),
    }
    print_costs(rows, capsys)
    assert rows["light tracer"][0] > rows["cells (ours)"][0]
    assert rows["volpath"][0] > rows["cells (ours)"][0]


def print_costs(
    rows: dict[str, tuple[float, float, float]], capsys: pytest.CaptureFixture[str]
) -> None:
    base, truth, _ = rows["cells (ours)"]
    with capsys.disabled():
        print("\nrenderer       cost (s)  times ours  brightness relative to ours")
        for name, (value, mean, error) in rows.items():
            print(
                f"{name:14} {value:8.3g} {value / base:11.1f} "
                f"{mean / truth:12.3f} +- {error / truth:.3f}"
            )


@pytest.fixture(scope="module")
def clear_pad() -> Scene:
    """Return a smooth clear pad with 11 lamps, 15 sites and 8 facets each."""
    pad = scene_of_case("smooth")
    return unchecked(
        pad,
        {
            "fibers": unchecked(pad.fibers, {"left": 4, "tip": 3, "right": 4}),
            "sites": unchecked(pad.sites, {"columns": 3, "rows": 5, "spacing": 4.0}),
            "indenter": unchecked(pad.indenter, {"faces": 8}),
        },
    )


def test_the_cost_of_facet_colors_and_of_the_table_of_a_clear_pad(
    mono: ModuleType, clear_pad: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    """A light tracer has nothing to show here: smooth faces cannot be connected to the camera."""
    from render.optics.lit_scene import lit_scene
    from render.sampling.monte_carlo import monte_carlo_replicates
    from tests.benchmarks.plain_renderers import by_volpath

    cells = problem(clear_pad, np.array([np.pi / 2]))
    camera, fibers = clear_pad.camera, clear_pad.lamp_count
    lit = lit_scene(
        clear_pad, np.full(fibers, np.pi / 2), np.ones(fibers), 0.0,
        width=camera.columns, height=camera.rows,
    )  # fmt: skip
    lanes, passes = 256, 16

    def colors(sampler: Any, lanes: int) -> Callable[[int, int], np.ndarray]:
        def ours(seed: int, passes: int) -> np.ndarray:
            found = monte_carlo_replicates(
                sampler, lanes=lanes, passes=passes, replicates=REPLICATES, seed=seed
            )
            return found.reshape(REPLICATES, fibers, -1).sum(axis=1)

        return ours

    phi = np.full((fibers, 1), np.pi / 2)
    apart = pad_cells(clear_pad, phi, 0.0, indented=True, sampler="pssmlt")
    rows = {
        "cells (ours)": cost(colors(cells, lanes), passes),
        "lamp by lamp": cost(colors(apart, 16384), 8),
        "volpath": cost(
            lambda s, n: by_volpath(clear_pad, lit, cells.targets, n, REPLICATES, s), 12
        ),
    }
    print_costs(rows, capsys)
    began = time.process_time()
    found = monte_carlo_replicates(cells, lanes=lanes, passes=passes, replicates=REPLICATES, seed=3)
    seconds = (time.process_time() - began) / CORES
    mean, variance = found.mean(axis=0), found.var(axis=0, ddof=1) / REPLICATES
    error = float(np.median(variance[mean > 0] / mean[mean > 0] ** 2))
    minutes = error / 0.03**2 * seconds / 60
    with capsys.disabled():
        print(f"the table of the clear pad at a median error of 3 %: {minutes:.2f} minutes, "
              f"{minutes / 5:.2f} of the allowed 5")  # fmt: skip
    assert rows["volpath"][0] > 50 * rows["cells (ours)"][0]


def test_the_training_table(
    mono: ModuleType, scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    """20 fibers x 11 direction nodes x 3 bends x 150 facets, both mirror images averaged."""
    from render.sampling.monte_carlo import monte_carlo_replicates

    nodes = chebyshev_nodes(11, 0.0, np.pi)
    minutes = []
    for bend in scene.bending.angles:
        cells = problem(scene, nodes, bend)
        lanes, passes = 8192, 4
        monte_carlo_replicates(cells, lanes=lanes, passes=1, replicates=REPLICATES, seed=1)
        began = time.process_time()
        found = monte_carlo_replicates(
            cells, lanes=lanes, passes=passes, replicates=REPLICATES, seed=2
        )
        seconds = (time.process_time() - began) / CORES
        mean, variance = found.mean(axis=0), found.var(axis=0, ddof=1) / REPLICATES
        seen = mean > 0
        # The median over cells of the squared relative error; halved by the mirror images.
        error = float(np.median(variance[seen] / mean[seen] ** 2)) / 2
        minutes.append(error / 0.03**2 * seconds / 60)
    with capsys.disabled():
        print(f"\nthe training table at a median error of 3 %: {sum(minutes):.1f} minutes, "
              f"{sum(minutes) / 30:.2f} of the allowed 30")  # fmt: skip
    assert np.isfinite(minutes).all()


def test_the_cost_of_blocks_of_a_slab(
    mono: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``slab_disk_beckmann`` by ``bdpt``: squared relative error of 8x8 blocks times seconds.

    The mean over blocks is comparable to 0.31, what Mitsuba 0.6's ``pssmlt`` costs there. Few
    bright samples make most of it, so variances come from the replicates of several runs.
    """
    from render.integrators.film_sampler import FilmSampler

    scene = slab(mono, tmp_path, lamp(mono))
    integrator: Any = mono.load_dict({"type": "bdpt", "replicates": 2 * REPLICATES})
    sampler = FilmSampler(scene, scene.sensors()[0], integrator.limits)

    def draw(seed: int, spp: int) -> np.ndarray:
        return blocks(integrator.replicate_images(sampler, seed, spp).reshape(-1, 64, 96))

    draw(1, 8)
    began = time.process_time()
    runs = [draw(seed, 64) for seed in (2, 3)]
    seconds = (time.process_time() - began) / CORES
    replicates = np.concatenate(runs)
    mean = replicates.mean(axis=0)
    each = replicates.var(axis=0, ddof=1) / len(replicates) / mean**2 * seconds
    with capsys.disabled():
        print("\nblocks of the slab            median cost (s)   mean cost (s)")
        for name, part in {"all": each, "where the coating is seen": each[COATED]}.items():
            print(f"{name:28} {np.median(part):17.4f} {part.mean():15.4f}")
    assert np.isfinite(each).all()
