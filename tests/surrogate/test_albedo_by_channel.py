"""Models of skins with an albedo per channel: copies of lamps, one for each albedo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.levels import TABLE
from render.preview import Preview
from render.preview.converged import ConvergedTransport
from render.scene import Scene
from render.transport import TransportTable, load_table
from surrogate.model.converged_grid import corrected
from surrogate.model.lamp_copies import (
    copied_poses,
    joined_channels,
    split_channels,
    split_power,
)
from surrogate.model.preview_grid import draw_grid
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from surrogate.runtime.model_file import OUTPUTS
from surrogate.train import TrainConfig, Trained, train
from surrogate.training.dataset import training_cells
from surrogate.training.fit_task import FitConfig
from surrogate.training.mlp import NetworkConfig
from surrogate.training.refit import NewRenders
from tests.colored_skins import skin_of, still

FLAT = np.array([0.0])
NODES = chebyshev_nodes(13, 0.0, np.pi)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def coarse(scene: Scene, cache: Path) -> Checker:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        return preview_checker(scene, coarse=True)


def test_light_of_copies_adds_up_to_that_of_all_channels() -> None:
    scene = skin_of((0.7, 0.3, 0.7))
    rng = np.random.default_rng(0)
    by_albedo = rng.random((2, scene.lamp_count, 5))
    light, power = by_albedo[[0, 1, 0]].transpose(1, 2, 0), rng.random((4, scene.lamp_count, 3))
    copies = split_channels(scene, light)
    assert copies.shape == (2 * scene.lamp_count, 5)
    np.testing.assert_array_equal(joined_channels(scene, copies), light)
    np.testing.assert_allclose(
        np.einsum("fx,nfc->nxc", copies, split_power(scene, power)),
        np.einsum("fxc,nfc->nxc", light, power),
    )
    places = copied_poses(scene).position
    np.testing.assert_array_equal(places[: scene.lamp_count], places[scene.lamp_count :])


def test_a_skin_of_one_albedo_has_its_lamps_for_copies() -> None:
    scene, values = skin_of(0.4), np.random.default_rng(0).random((2, 3))
    for made in (split_channels, split_power, joined_channels):
        assert made(scene, values) is values


def test_the_previews_model_is_that_of_each_channels_albedo(cache: Path) -> None:
    scene = skin_of()
    found = coarse(scene, cache).transport_table(np.array([0.4, 1.2, 2.0]))
    assert found.by_channel
    for channel, one in enumerate(scene.one_albedo_scenes):
        alone = coarse(one, cache).transport_table(found.phi)
        for name in ("T", "se", "background", "background_se"):
            np.testing.assert_allclose(
                getattr(found, name)[..., channel], getattr(alone, name), rtol=1e-5, err_msg=name
            )


def reference(scene: Scene, noise: float = 0.05) -> TransportTable:
    """Return the preview, brighter and with noise in both halves, as a table of renders."""
    with Preview(scene) as preview:
        light = preview.transport(np.array([np.pi / 2]), FLAT)
    brighter = 1.3 * np.exp(0.2 * np.sin(np.arange(light[0].shape[3])))[:, None]
    facets, pad = light[0] * brighter[..., None], light[1] * brighter
    # Channels share the noise, as they share light paths.
    rng = np.random.default_rng(0)
    cells = np.concatenate([facets, np.expand_dims(pad, 4)], axis=4)
    halves = [cells * (1 + noise * rng.standard_normal((*cells.shape[:5], 1))) for _ in range(2)]
    mean, half = 0.5 * (halves[0] + halves[1]), 0.5 * (halves[0] - halves[1])
    facet, last = np.s_[:, :, :, :, :-1], np.s_[:, :, :, :, -1]
    error = noise / np.sqrt(2.0) * cells
    return TransportTable(
        T=mean[facet], se=error[facet], phi=np.array([np.pi / 2]), exposure=1.0, lam=0.0,
        scene_hash=scene.hash, bends=FLAT, background=mean[last], background_se=error[last],
        half_difference=half,
    )  # fmt: skip


CONFIG = TrainConfig(
    preview_nodes=(5, 1),
    coarse=True,
    fit=FitConfig(
        members=2, network=NetworkConfig(width=8, steps=60, batch=64), penalties=(1e-2,), designs=30
    ),
)


@pytest.fixture(scope="module")
def lamps() -> Scene:
    return still()


@pytest.fixture(scope="module")
def colored(lamps: Scene, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    folder = tmp_path_factory.mktemp("models") / "colored"
    return train(lamps, folder, table=reference(lamps), config=CONFIG)


def test_a_table_of_renders_becomes_a_model_with_an_axis_of_channels(
    lamps: Scene, colored: Trained
) -> None:
    assert colored.metadata.residual["kind"] == TABLE
    assert colored.metadata.by_channel
    table = Checker.for_scene(colored.folder, lamps).transport_table(colored.table.phi)
    assert table.T.shape == colored.table.T.shape
    with Preview(lamps) as preview:
        drawn, _ = preview.transport(table.phi, FLAT)
    off, before = (np.abs(part / colored.table.T - 1).mean() for part in (table.T, drawn))
    assert off < 0.2 * before
    ratio = (table.T / colored.table.T).reshape(-1, 3)
    assert np.abs(ratio - 1).mean(axis=0).max() < 0.05


def test_the_graph_superposes_channel_by_channel(lamps: Scene, colored: Trained) -> None:
    checker = Checker.for_scene(colored.folder, lamps)
    table = checker.transport_table(colored.table.phi)
    power = 0.3 * np.random.default_rng(1).random((4, lamps.lamp_count, 3))
    said = checker.run(np.full(power.shape[:2], np.pi / 2), power, FLAT)
    light = checker.exposure * np.einsum("fbskc,nfc->nbskc", table.T[:, 0], power)
    pad = checker.exposure * np.einsum("fbsc,nfc->nbsc", table.background[:, 0], power)
    np.testing.assert_allclose(said["counts"], np.minimum(light, 255.0), rtol=1e-4)
    np.testing.assert_allclose(said["background"], np.minimum(pad, 255.0), rtol=1e-4)
    variance = np.einsum("fbskc,nfc->nbskc", table.se[:, 0] ** 2, power**2)
    expected = checker.exposure * np.sqrt(variance)
    np.testing.assert_allclose(said["counts_spread"], expected, rtol=1e-4)


def test_a_golden_pair_lies_beside_the_model(colored: Trained) -> None:
    with np.load(colored.folder / "golden.npz") as golden:
        assert set(OUTPUTS) <= set(golden.files)
        assert golden["counts"].shape[-1] == 3


def test_a_table_with_channels_is_written_and_read(colored: Trained, tmp_path: Path) -> None:
    colored.table.save(tmp_path / "table.npz")
    again = load_table(tmp_path / "table.npz")
    assert again.by_channel
    np.testing.assert_array_equal(again.T, colored.table.T)
    np.testing.assert_array_equal(again.half_difference, colored.table.half_difference)


def test_a_table_without_channels_is_none_of_such_a_scene(lamps: Scene) -> None:
    table = reference(lamps)
    names = ("T", "se", "background", "background_se", "half_difference")
    plain = replace(table, **{name: getattr(table, name)[..., 0] for name in names})
    with pytest.raises(TableError, match=r"\(fiber, site, facet, channel\) = \(2, 6, 6\), allowed"):
        training_cells(lamps, [plain])


@pytest.mark.slow
def test_networks_learn_directions_in_all_channels(tmp_path: Path) -> None:
    scene = skin_of()
    phi = np.linspace(0.2, 2.9, 5)
    with Preview(scene) as preview:
        drawn, pad = preview.transport(phi, FLAT)
    brighter = 1.0 + 0.5 * np.sin(phi)[:, None, None, None, None]
    table = TransportTable(
        T=drawn * brighter, se=0.01 * drawn, phi=phi, exposure=1.0, lam=0.0, scene_hash=scene.hash,
        bends=FLAT, background=pad * brighter[..., 0], background_se=0.01 * pad,
    )  # fmt: skip
    made = train(scene, tmp_path / "model", table=table, config=CONFIG)
    found = Checker.for_scene(made.folder, scene).transport_table(phi)
    assert found.by_channel
    assert np.median(np.abs(found.T / table.T - 1)) < 0.3 * np.median(np.abs(drawn / table.T - 1))


def test_new_renders_are_split_into_copies() -> None:
    scene = skin_of((0.7, 0.3, 0.7))
    rng = np.random.default_rng(0)
    by_albedo = rng.random((4, 2, 2, 1, 6, 7, 2))
    run = NewRenders(
        rng.random((2, 2)), FLAT, by_albedo[..., [0, 1, 0]], by_albedo[0][..., [0, 1, 0]]
    )
    split = run.split(scene)
    assert split.copies == 2
    np.testing.assert_array_equal(split.phi, np.concatenate([run.phi, run.phi], axis=1))
    for albedo in (0, 1):
        own = slice(2 * albedo, 2 * albedo + 2)
        np.testing.assert_array_equal(split.replicates[:, :, own], by_albedo[..., albedo])
        np.testing.assert_array_equal(split.predicted[:, own], by_albedo[0][..., albedo])


def test_channels_change_places_as_their_albedos_do(cache: Path) -> None:
    there, back = (
        coarse(skin_of(albedos), cache) for albedos in ((0.7, 0.3, 0.5), (0.5, 0.7, 0.3))
    )
    power = np.random.default_rng(2).random((3, 2, 3))
    phi = np.full((3, 2), 1.3)
    # Exposure is that of the baseline's own colors, so it is taken off.
    first = there.run(phi, 0.2 * power, FLAT)["counts"] / there.exposure
    second = back.run(phi, 0.2 * power[..., [2, 0, 1]], FLAT)["counts"] / back.exposure
    np.testing.assert_allclose(first[..., [2, 0, 1]], second, rtol=1e-5)


def test_the_grid_of_such_a_scene_holds_each_albedo_in_turn() -> None:
    scene = skin_of()
    grid = draw_grid(scene, 3, 1)
    alone = [draw_grid(one, 3, 1).log_transport for one in scene.one_albedo_scenes]
    np.testing.assert_array_equal(grid.log_transport, np.concatenate(alone))


def test_converged_light_corrects_each_albedo_by_its_own() -> None:
    scene, rng = skin_of(), np.random.default_rng(6)
    grids = [draw_grid(one, 3, 1) for one in scene.one_albedo_scenes]
    found = []
    for grid in grids:
        drawn = np.exp(grid.evaluate(NODES, FLAT))
        cells = drawn * rng.uniform(0.7, 1.4, drawn.shape)
        grain = 1e-3 * drawn.mean() * rng.uniform(0.5, 2.0, drawn.shape[:3])
        found.append(ConvergedTransport(cells, grain, np.zeros(1)))
    cells, grain = (np.stack(each, axis=-1) for each in list(zip(*found, strict=True))[:2])
    together = ConvergedTransport(cells, grain, np.zeros(1))
    whole = corrected(draw_grid(scene, 3, 1), scene, together)
    alone = [
        corrected(grid, one, own).log_transport
        for grid, one, own in zip(grids, scene.one_albedo_scenes, found, strict=True)
    ]
    np.testing.assert_allclose(whole.log_transport, np.concatenate(alone), rtol=1e-10)
