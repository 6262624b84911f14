"""The residual of a skin with states whose lamps turn: inputs that name the state, and training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from render.arrays import Array
from render.metric import image_counts
from render.preview import Preview
from render.scene import Scene, load_scene
from render.transport import TransportTable
from surrogate.model.checker_module import PreviewTable
from surrogate.model.facet_basis import mirror_signs
from surrogate.model.features import FEATURE_NAMES, CellFeatures, feature_names
from surrogate.model.preview_grid import draw_grid, grid_nodes
from surrogate.runtime import Checker
from surrogate.train import TrainConfig, train
from tests.oracles.soft_domes import round_scene_text, scene_text_of, write_files, written

FACTORS = np.array([1.0, 1.35, 0.8])
"""Light over the preview in the states rest, r60 and r30: in no order of their numbers."""
TREND = np.array([0.0, 0.15, -0.1])
"""By how much the logarithm of that grows with the sine of a lamp's direction."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("dome")
    text = round_scene_text(60.0, 30.0).replace("turns = false", "turns = true")
    return written(folder, text.replace("sites.rows = 3", "sites.rows = 2"))


def light_of(scene: Scene, phi: Array) -> tuple[Array, Array]:
    """Return the invented light ``(fiber, node, state, site, facet)`` and of the untouched pad."""
    with Preview(scene) as preview:
        facets, pad = preview.transport(phi, np.array(scene.state_axis))
    over = FACTORS * np.exp(TREND * np.sin(phi)[:, None])
    return facets * over[..., None, None], pad * over[..., None]


def test_every_state_but_the_rest_is_an_input_of_its_own(scene: Scene) -> None:
    grid = draw_grid(scene, 5, 9)
    phi = torch.full((2, scene.lamp_count), 1.0)
    bend = torch.tensor([[0.0, 1.0, 2.0]] * 2)
    x = CellFeatures(scene, grid)(phi, bend, PreviewTable(grid)(phi, bend))
    names = feature_names(scene)
    assert len(x) == len(names) == len(FEATURE_NAMES) + 1
    for number, state in enumerate(("r60", "r30"), start=1):
        told = x[names.index(f"in state {state}")]
        expected = (bend == number).float()[:, None, :, None].expand_as(told)
        assert torch.equal(told, expected)
    assert "bend" not in names
    assert feature_names(load_scene("finger20")) == FEATURE_NAMES


def test_lamps_are_twins_only_where_no_state_moves_the_skin_to_one_side(
    scene: Scene, tmp_path: Path
) -> None:
    write_files(tmp_path, steps=16)
    assert set(mirror_signs(scene)) == {1.0, -1.0}
    assert set(mirror_signs(written(tmp_path, scene_text_of("twisted")))) == {1.0}


@pytest.mark.slow
def test_a_trained_model_knows_the_light_of_each_state(
    scene: Scene, quick: TrainConfig, tmp_path: Path
) -> None:
    phi, states = grid_nodes(scene, 7, 9)
    facets, pad = light_of(scene, phi)
    table = TransportTable(
        T=facets, se=1e-3 * facets, phi=phi, exposure=1.0, lam=0.0, scene_hash=scene.hash,
        bends=states, background=pad, background_se=1e-3 * pad,
    )  # fmt: skip
    config = replace(quick, preview_nodes=(17, 9), fit=replace(quick.fit, penalties=(1e-7,)))
    made = train(scene, tmp_path / "model", table=table, config=config)
    assert made.fit.kind in ("ridge", "network")
    # A state is no value between others, so none was left out.
    assert [split.name for split in made.fit.splits] == [
        "unseen fiber position",
        "unseen direction",
    ]
    checker = Checker.for_scene(tmp_path / "model", scene)
    assert checker.metadata.states == ["rest", "r60", "r30"]
    # At a direction that no node has, from light that was drawn there.
    between = np.array([0.9])
    colors = np.eye(3)[np.arange(scene.lamp_count) % 3] * 0.9
    truth = image_counts(light_of(scene, between)[0][:, 0], colors, checker.exposure)
    said = checker.run(np.full((1, scene.lamp_count), 0.9), colors[None], states)
    lit = (truth > 1.0) & (truth < 250.0)
    off = np.abs(said["counts"][0] / truth - 1.0)
    assert said["domain_excess"][0] == 0.0
    for number in range(3):
        assert np.median(off[number][lit[number]]) < 0.03
    # An input that ordered the states would miss the light of one by a fifth.
    with Preview(scene) as preview:
        drawn, _ = preview.transport(between, states)
    plain = image_counts(drawn[:, 0], colors, checker.exposure)
    assert np.median(np.abs(plain / truth - 1.0)[1][lit[1]]) > 0.25
