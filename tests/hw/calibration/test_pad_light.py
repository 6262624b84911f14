"""The rendered pad agrees with the reference's own cells, and is read where it is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.pad_light import BLOCKS, PadLight, render_pad_light
from hw.calibration.reference_lines import Setup
from render.arrays import Array
from render.geometry import declared_sites, facet_masks
from render.scene import Scene, load_scene, unchecked

pytestmark = pytest.mark.slow

LIT = [0, 4, 9]


def small_scene() -> Scene:
    scene = load_scene("finger20")
    camera = unchecked(scene.camera, {"rows": 300, "columns": 180})
    sites = unchecked(scene.sites, {"columns": 1, "rows": 2, "spacing": 6.0})
    return unchecked(scene, {"camera": camera, "sites": sites})


def reference_cells(scene: Scene, bend: float) -> tuple[Array, Array]:
    """Return the reference's own background cells and errors, ``(fiber, site)``."""
    from render.cells.cell_sampler import CellSampler, Targets
    from render.sampling.monte_carlo import MonteCarlo

    masks = facet_masks(scene, bend)
    lists = [masks.of(site, scene.indenter.faces) for site in range(scene.sites.count)]
    targets = Targets(np.concatenate(lists), np.cumsum([0, *(len(pixels) for pixels in lists)]))
    lit = np.ones((len(lists), 20), dtype=bool)
    sampler = CellSampler(scene, np.full((20, 1), np.pi / 2), bend, False, targets, lit=lit)
    run = MonteCarlo(sampler, 4096, 8, 2)
    run.sample(10)
    found = run.estimate().reshape(8, 20, -1)
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(8)


@pytest.fixture(scope="module")
def light() -> PadLight:
    """Return the small scene's pad, bent, under some fibers."""
    scene = small_scene()
    setup = Setup(scene, np.full(20, np.pi / 2), np.array([0.6]))
    whole = np.mgrid[-8.0:9.0:2.0, -14.0:15.0:2.0].reshape(2, -1).T
    around = np.broadcast_to(whole, (20, *whole.shape))
    return render_pad_light(setup, [LIT], samples=150, seed=1, around=around)


@pytest.mark.usefixtures("mono")
def test_it_agrees_with_the_references_own_cells(light: PadLight) -> None:
    scene = small_scene()
    wanted, wanted_error = reference_cells(scene, 0.6)
    centers = declared_sites(scene)[:, :2]
    offsets = np.mgrid[-1:2, -1:2].reshape(2, -1).T * light.cell / light.blocks
    misses, errors = [], []
    for fiber in LIT:
        found = [light.at(0, fiber, centers + offset) for offset in offsets]
        values, own = np.mean(found, axis=0)
        misses.append((values - wanted[fiber]) / np.hypot(own, wanted_error[fiber]))
        errors.append(own / values)
    assert np.abs(misses).max() < 4.0
    assert np.median(errors) < 0.3


def test_fibers_that_are_not_lit_stay_unknown(light: PadLight) -> None:
    assert all(np.isfinite(light.radiance[0, fiber]).any() for fiber in LIT)
    assert np.isnan(np.delete(light.radiance[0], LIT, axis=0)).all()


def ramp() -> PadLight:
    """Return a light that grows by 1 per mm of x and 10 per mm of y on a pad of 4 x 6 mm."""
    x, y = ((np.arange(n * BLOCKS) + 0.5) / BLOCKS * 2.0 - n for n in (2, 3))
    field = (x[None] + 10.0 * y[:, None])[None, None]
    return PadLight(2.0, BLOCKS, field, np.ones(field.shape))


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (-1.3, 2.2), (1.75, -2.75)])
def test_light_is_linear_between_blocks(x: float, y: float) -> None:
    value, error = ramp().at(0, 0, np.array([[x, y]]))
    assert value == pytest.approx(x + 10 * y)
    assert error == 1.0


def test_cells_are_numbered_from_the_base() -> None:
    corners = np.array([[-1.9, -2.9], [1.9, -2.9], [-1.9, 2.9]])
    assert ramp().square_of(corners, BLOCKS).tolist() == [0, 1, 4]


def test_what_was_not_rendered_is_not_read() -> None:
    light = ramp()
    light.radiance[0, 0, :, 0] = np.nan
    assert np.isnan(light.at(0, 0, np.array([[-1.75, 0.0]]))[0]).all()


def test_positions_are_the_middles_of_blocks() -> None:
    positions = ramp().positions()
    assert positions.shape == (12, 8, 2)
    np.testing.assert_allclose(positions[0, 0], [-1.75, -2.75])
    values, _ = ramp().at(0, 0, positions)
    np.testing.assert_allclose(values, ramp().radiance[0, 0])
