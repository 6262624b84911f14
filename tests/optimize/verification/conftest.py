"""A small sensor whose surrogate is its preview."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from optimize.design import baseline_design
from render.chebyshev import chebyshev_nodes
from render.choose_exposure import scale_of
from render.preview import Preview
from render.scene import Scene, load_scene, unchecked
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid, draw_grid


@pytest.fixture(scope="package")
def small() -> Scene:
    scene = load_scene("finger20")
    fibers = unchecked(scene.fibers, {"left": 3, "tip": 2, "right": 3})
    sites = unchecked(scene.sites, {"columns": 2, "rows": 2})
    indenter = unchecked(scene.indenter, {"faces": 5})
    bending = unchecked(scene.bending, {"angles": scene.bending.angles[:2]})
    return unchecked(
        scene, {"fibers": fibers, "sites": sites, "indenter": indenter, "bending": bending}
    )


@pytest.fixture(scope="package")
def grid(small: Scene) -> PreviewGrid:
    return draw_grid(small, 7, 3)


@pytest.fixture(scope="package")
def table(small: Scene) -> TransportTable:
    """Return the preview, which is the surrogate here."""
    phi, bends = chebyshev_nodes(13, 0.0, np.pi), np.array(small.bending.angles)
    with Preview(small) as preview:
        transport, background = preview.transport(phi, bends)
    plain = TransportTable(
        T=transport,
        se=0.03 * transport,
        phi=phi,
        exposure=1.0,
        lam=1.0,
        level="surrogate",
        bends=bends,
        background=background,
        background_se=0.03 * background,
    )
    base = baseline_design(small)
    return replace(plain, **asdict(scale_of(plain.at(base.phi), base.power)))
