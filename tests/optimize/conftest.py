"""A small invented sensor: fibers around a disc, light that falls off with distance and angle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from render.chebyshev import chebyshev_nodes
from render.metric import choose_exposure, choose_lambda, image_counts
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


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
