"""What tests of the optimizer share: a small invented sensor, and stages with invented figures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from optimize.design import Design, Rating, baseline_design
from optimize.stages import Stage
from render.chebyshev import chebyshev_nodes
from render.metric import choose_exposure, choose_lambda, image_counts
from render.scene import Scene, load_scene
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
StageMaker = Callable[[float, float, float], list[Stage]]


def invent_table(
    fibers: int = 8,
    nodes: int = 5,
    bends: int = 2,
    sites: int = 4,
    facets: int = 6,
    *,
    error: float = 0.0,
    lam: float | None = None,
    level: str = "reference",
    seed: int = 0,
) -> TransportTable:
    """Return a table of fibers around a disc, whose light fades with distance and angle."""
    rng = np.random.default_rng(seed)
    around = 2 * np.pi * (np.arange(fibers) + 0.5) / fibers
    inward = -np.stack([np.sin(around), np.cos(around)], axis=-1)
    along = np.stack([inward[:, 1], -inward[:, 0]], axis=-1)
    phi = chebyshev_nodes(nodes, 0.0, np.pi)
    beam = np.cos(phi)[:, None] * along[:, None] + np.sin(phi)[:, None] * inward[:, None]
    ray = rng.uniform(-0.5, 0.5, (sites, 2)) + inward[:, None]
    distance = np.linalg.norm(ray, axis=-1)
    azimuth = 2 * np.pi * np.arange(facets) / facets
    normal = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    spot = np.exp(2.0 * np.einsum("fjx,fsx->fjs", beam, ray) / distance[:, None])
    shade = np.maximum(1.0 - np.einsum("kx,fsx->fsk", normal, ray), 0.05)
    fade = np.exp(-np.linspace(0.0, 0.5, bends)[:, None, None] * distance) / distance**2
    transport = np.einsum("fjs,fsk,bfs->fjbsk", spot, shade, fade)
    ahead = np.full(fibers, np.pi / 2)
    thirds = np.eye(3)[np.arange(fibers) * 3 // fibers]
    plain = TransportTable(transport, error * transport, phi, 1.0, 0.0)
    exposure = choose_exposure(np.einsum("fbsk,fc->bskc", plain.at(ahead), thirds))
    if lam is None:
        lam = choose_lambda(image_counts(plain.at(ahead), thirds, exposure))
    return TransportTable(transport, error * transport, phi, exposure, lam, level=level)


@pytest.fixture
def make_table() -> MakeTable:
    return invent_table


@pytest.fixture(scope="session")
def finger20() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="session")
def sample_stages(finger20: Scene) -> StageMaker:
    """Make baseline, colours and optimised stages with given scores, each plus minus 3."""
    return lambda *scores: _stages(finger20, scores)


def _stages(scene: Scene, scores: tuple[float, ...]) -> list[Stage]:
    """Return stages whose other figures are made up, for what only shows them."""
    rng = np.random.default_rng(7)
    base = baseline_design(scene)
    shape = (len(scene.bending.angles), scene.sites.count)
    mixed = np.arange(scene.fibers.count) % 3
    designs = [
        base,
        Design.of_colours(base.phi, mixed),
        Design.of_colours(rng.uniform(0.5, 2.6, scene.fibers.count), mixed),
    ]
    texts = [
        ("baseline", "Baseline", ""),
        ("colours", "Colours", "the colour search"),
        ("optimized", "Optimised", "the fiber directions"),
    ]
    return [
        Stage(
            key=key,
            title=title,
            change=change,
            design=design,
            rating=Rating(
                level="surrogate",
                score=score,
                interval=(score - 3, score + 3),
                mean=score + 20,
                spread_sites=12.0,
                spread_bends=8.0,
                lam=84.0,
                exposure=3000.0,
            ),
            metric=rng.uniform(20, 80, shape),
            counts=rng.uniform(0, 255, (*shape, scene.indenter.faces, 3)),
            clipped=0.0,
            domain_excess=0.0,
        )
        for (key, title, change), design, score in zip(texts, designs, scores, strict=True)
    ]
