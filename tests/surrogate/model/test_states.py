"""States of a skin in models: their numbers are the axis of bends, with nothing between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from render.choose_exposure import ScoreScale
from render.errors import ModelError, TableError
from render.metric import THESIS, image_counts
from render.preview import Preview
from render.scene import Scene, load_scene
from render.transport import TransportTable
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid, draw_grid, is_one_node
from surrogate.model.scene_facts import scene_facts
from surrogate.preview_model import PreviewSession, preview_checker
from surrogate.train import train
from surrogate.training.render_plan import training_bends
from tests.oracles.soft_domes import round_scene_text

EXPOSURE, LAM = 4.0e5, 2.0
POWER = np.eye(3)[[0, 0, 1, 1, 2, 2]][None] * 0.8
PHI = np.full((1, 6), np.pi / 2)


def dome(folder: Path, *changes: tuple[str, str]) -> Scene:
    text = round_scene_text(60.0, crown=5.2)
    for old, new in changes:
        text = text.replace(old, new)
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return dome(tmp_path_factory.mktemp("dome"))


@pytest.fixture(scope="module")
def grid(scene: Scene) -> PreviewGrid:
    return draw_grid(scene, 5, 9)


def outputs_of(module: CheckerModule, bends: list[float]) -> dict[str, np.ndarray]:
    given = [torch.as_tensor(x, dtype=torch.float32) for x in (PHI, POWER, [bends])]
    with torch.no_grad():
        return {name: part.numpy() for name, part in module(*given)._asdict().items()}


def test_the_nodes_of_a_model_are_the_states(scene: Scene, grid: PreviewGrid) -> None:
    np.testing.assert_array_equal(grid.bends, [0.0, 1.0])
    np.testing.assert_array_equal(training_bends(scene, 5), grid.bends)
    assert is_one_node(scene)
    assert scene_facts(scene, grid)["states"] == ["rest", "r60"]
    assert scene_facts(load_scene("digit"), grid)["states"] == []


def test_a_model_has_the_light_of_each_state_and_says_where_there_is_none(
    scene: Scene, grid: PreviewGrid
) -> None:
    module = CheckerModule(
        scene, grid, NoResidual(SIZE), exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.0)
    )
    session = PreviewSession(scene, grid, ScoreScale(EXPOSURE, LAM), 0.1)
    with Preview(scene) as preview:
        light, _ = preview.transport(np.array([np.pi / 2]), np.array(scene.state_axis))
    truth = image_counts(light[:, 0], POWER[0], EXPOSURE, THESIS)
    found = outputs_of(module, [0.0, 1.0])
    drawn = session.outputs(PHI, POWER, np.array([0.0, 1.0]))
    for counts in (found["counts"], drawn["counts"]):
        np.testing.assert_allclose(counts[0], truth, rtol=2e-5)
    assert found["domain_excess"][0] == drawn["domain_excess"][0] == 0.0
    for near, nearest in ((0.7, 1.0), (0.1, 0.0), (1.3, 1.0)):
        beside = outputs_of(module, [near]), session.outputs(PHI, POWER, np.array([near]))
        for outputs in beside:
            np.testing.assert_allclose(outputs["counts"][0, 0], truth[int(nearest)], rtol=2e-5)
            assert outputs["domain_excess"][0] > 0.0


@pytest.mark.slow
def test_a_checker_names_its_states_and_refuses_numbers_of_none(scene: Scene) -> None:
    checker = preview_checker(scene, coarse=True)
    assert checker.metadata.states == ["rest", "r60"]
    assert checker.metadata.scene_bends == [0.0, 1.0]
    assert "states" in checker.metadata.to_props()
    assert checker.transport_table(np.array([np.pi / 2])).T.shape == (6, 1, 2, 9, 6)
    with pytest.raises(ModelError, match=r"bends = 2 \(a state's number\), allowed: 0 to 1"):
        checker.run(PHI, POWER, np.array([2.0]))


def test_a_table_of_other_states_raises_one_clear_error(scene: Scene, tmp_path: Path) -> None:
    table = TransportTable(
        T=np.ones((6, 1, 3, 9, 6)),
        se=np.ones((6, 1, 3, 9, 6)),
        phi=np.array([np.pi / 2]),
        exposure=1.0,
        lam=1.0,
        bends=np.array([0.0, 1.0, 2.0]),
        background=np.ones((6, 1, 3, 9)),
        background_se=np.ones((6, 1, 3, 9)),
        scene_hash=scene.hash,
    )
    with pytest.raises(TableError, match=r"has the states .*, allowed: the numbers of the scene's"):
        train(scene, tmp_path / "model", table=table)
