"""A small sensor with a real, quickly trained model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.chebyshev import chebyshev_nodes
from render.preview import Preview
from render.scene import Scene, load_scene
from render.transport import TransportTable

ROOT = Path(__file__).parents[3]
# finger20 with 8 fibers, 4 sites, 5 facets, 2 bends.
SMALLER = {
    'name = "finger20"': 'name = "small8"',
    "left = 8": "left = 3",
    "tip = 4": "tip = 2",
    "right = 8": "right = 3",
    "columns = 3": "columns = 2",
    "rows = 5": "rows = 2",
    "faces = 10": "faces = 5",
    "value = [0.0, 45.0, 90.0]": "value = [0.0, 45.0]",
}


@pytest.fixture(scope="session")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the scene file of the small sensor."""
    text = (ROOT / "render" / "scenes" / "finger20.toml").read_text()
    for old, new in SMALLER.items():
        assert old in text
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("scene") / "small8.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="session")
def small_reference(small_scene: Path) -> TransportTable:
    """Return what stands for renders: the preview, dimmer at flat angles, with 1 % error."""
    scene = load_scene(small_scene)
    phi, bends = chebyshev_nodes(7, 0.0, np.pi), np.radians([0.0, 22.5, 45.0])
    with Preview(scene) as preview:
        facets, pad = preview.transport(phi, bends)
    dimming = (0.8 + 0.2 * np.sin(phi))[:, None, None]
    facets, pad = facets * dimming[..., None], pad * dimming
    return TransportTable(
        T=facets,
        se=0.01 * facets,
        phi=phi,
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        bends=bends,
        background=pad,
        background_se=0.01 * pad,
    )


@pytest.fixture(scope="session")
def small_model(
    small_scene: Path, small_reference: TransportTable, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Train a model of the small sensor, with as few steps as the real code can do with."""
    from surrogate.train import TrainConfig, train
    from surrogate.training.fit_task import FitConfig
    from surrogate.training.mlp import NetworkConfig

    scene: Scene = load_scene(small_scene)
    folder = tmp_path_factory.mktemp("models") / scene.name
    quick = FitConfig(members=2, network=NetworkConfig(width=8, steps=100), designs=40)
    config = TrainConfig(preview_nodes=(9, 3), coarse=True, fit=quick)
    train(scene, folder, table=small_reference, config=config)
    return folder
