"""What tests of the surrogate share: a small sensor, its real preview, and a known residual."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from render.preview import Preview
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid, draw_grid, grid_nodes
from surrogate.train import TrainConfig, Trained, train
from surrogate.training.fit_task import FitConfig
from surrogate.training.mlp import NetworkConfig
from tests.small_scenes import small_scene

PHI_NODES, BEND_NODES = 7, 5


def invent_reference(scene: Scene, noise: float = 0.02, seed: int = 0) -> TransportTable:
    """Return the preview times a smooth, mirror-symmetric residual, with noise of known size."""
    phi, bends = grid_nodes(scene, PHI_NODES, BEND_NODES)
    with Preview(scene) as preview:
        transport, background = preview.transport(phi, bends)
    ahead = np.sin(phi)[:, None, None]
    trend = 0.4 + 0.3 * ahead - 0.2 * (bends / np.pi)[:, None]
    azimuth = 2 * np.pi * np.arange(scene.indenter.faces) / scene.indenter.faces
    facets = transport * np.exp(trend[..., None] + 0.2 * np.cos(azimuth))
    untouched = background * np.exp(trend)
    rng = np.random.default_rng(seed)

    def noisy(values: np.ndarray) -> np.ndarray:
        return np.asarray(values * (1 + noise * rng.standard_normal(values.shape)))

    return TransportTable(
        T=noisy(facets),
        se=noise * facets,
        phi=phi,
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        bends=bends,
        background=noisy(untouched),
        background_se=noise * untouched,
    )


SceneMaker = Callable[..., Scene]


@pytest.fixture(scope="session")
def make_scene() -> SceneMaker:
    """Make the small sensor with some keys of some parts replaced."""
    return small_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return small_scene()


@pytest.fixture(scope="session")
def grid(scene: Scene) -> PreviewGrid:
    return draw_grid(scene, PHI_NODES, BEND_NODES)


@pytest.fixture(scope="session")
def reference(scene: Scene) -> TransportTable:
    return invent_reference(scene)


@pytest.fixture(scope="session")
def quick() -> TrainConfig:
    """A training of seconds."""
    network = NetworkConfig(width=8, steps=200, batch=256)
    fit = FitConfig(members=3, network=network, penalties=(1e-4,), designs=40)
    return TrainConfig(preview_nodes=(PHI_NODES, BEND_NODES), coarse=True, fit=fit)


@pytest.fixture(scope="session")
def trained(
    scene: Scene,
    reference: TransportTable,
    quick: TrainConfig,
    tmp_path_factory: pytest.TempPathFactory,
) -> Trained:
    """A model of the small sensor, made by the real training."""
    folder = tmp_path_factory.mktemp("models") / "small"
    return train(scene, folder, table=reference, config=quick, command="tactilux train small")


@pytest.fixture(scope="session")
def model_folder(trained: Trained) -> Path:
    return trained.folder
