"""Reduced scattering and diffuser thickness as inputs of the surrogate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from render.describe import describe
from render.errors import ModelError, SceneError, TableError
from render.preview import Preview
from render.scene import FreeRanges, Scene, load_scene, unchecked
from render.transport import TransportTable
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import PreviewGrid, draw_material_grid
from surrogate.runtime import Checker, family_hash
from surrogate.train import TrainConfig, Trained, train
from surrogate.training.dataset import training_cells
from surrogate.training.fit import fit_residual
from surrogate.training.fit_task import FitConfig, FitTask
from surrogate.training.mlp import NetworkConfig

pytestmark = pytest.mark.slow

RAYS = 20_000
RANGES = FreeRanges.model_construct(reduced_scattering=(0.7, 1.4), diffuser_thickness=(1.5, 2.5))


@pytest.fixture(scope="module")
def sensor(make_scene: Callable[..., Scene]) -> Scene:
    """A small sensor with both quantities free."""
    return unchecked(
        make_scene(
            fibers={"left": 2, "tip": 1, "right": 2},
            sites={"columns": 1, "rows": 2},
            bending={"angles": {"value": [0.0], "unit": "deg", "source": "test"}},
        ),
        {"free": RANGES},
    )


@pytest.fixture(scope="module", autouse=True)
def quick_slabs(tmp_path_factory: pytest.TempPathFactory) -> None:
    patch = pytest.MonkeyPatch()
    patch.setattr("render.preview.lights.RAYS", RAYS)
    patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("slabs")))
    yield
    patch.undo()


@pytest.fixture(scope="module")
def free_model(sensor: Scene, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A model from real renders of a few samples: what `tactilux train` makes, in small."""
    network = NetworkConfig(width=8, steps=200, batch=256)
    config = TrainConfig(
        samples=300,
        phi_nodes=5,
        bend_nodes=2,
        preview_nodes=(5, 3),
        materials=4,
        preview_materials=8,
        fit=FitConfig(members=3, network=network, penalties=(1e-2,), designs=40),
    )
    return train(sensor, tmp_path_factory.mktemp("free") / "small", config=config)


def at_material(grid: PreviewGrid, material: np.ndarray) -> np.ndarray:
    """Return the log preview at the nodes of ``grid`` for one material ``(quantity,)``."""
    assert grid.free is not None
    assert grid.slopes is not None
    return grid.log_transport + np.tensordot(grid.free.terms(material), grid.slopes, axes=1)


def test_a_range_must_hold_the_scenes_own_value_and_need_a_diffuser(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()

    def read(section: str, base: str = text) -> Scene:
        path = tmp_path / "scene.toml"
        path.write_text(base + "\n[free]\n" + section)
        return load_scene(path)

    entry = 'diffuser_thickness = {{ value = {}, unit = "mm", source = "test" }}\n'
    assert read(entry.format("[1.5, 2.5]")).hash == load_scene("finger20").hash
    for values, message in (
        ("[2.5, 3.0]", "allowed: a range around the scene's own 2 mm"),
        ("[2.5, 1.5]", "allowed: two values, ascending"),
        ("[2.0]", "allowed: two values, ascending"),
        ("[0.01, 3.0]", "allowed: 0.1 to 20 mm"),
    ):
        with pytest.raises(SceneError, match=message):
            read(entry.format(values))
    with pytest.raises(SceneError, match="free names nothing"):
        read("")
    start, stop = text.index("[diffuser]"), text.index("[coating]")
    with pytest.raises(SceneError, match="the scene has no diffuser, leave it out"):
        read(entry.format("[1.5, 2.5]"), text[:start] + text[stop:])
    told = describe(read(entry.format("[1.5, 2.5]"))).text()
    assert "diffuser_thickness: 1.5 to 2.5 mm" in told


def test_materials_fill_the_range_and_the_scenes_own_comes_first(sensor: Scene) -> None:
    free = MaterialRange.of(sensor)
    assert free is not None
    chosen = free.samples(9)
    np.testing.assert_allclose(chosen[0], [1.0, 2.0])
    np.testing.assert_allclose([chosen[1:].min(axis=0), chosen[1:].max(axis=0)],
                               [[0.7, 1.5], [1.4, 2.5]])  # fmt: skip
    np.testing.assert_allclose(free.from_unit(free.unit(chosen)), chosen)
    np.testing.assert_array_equal(free.terms(free.nominal), 0.0)
    other = free.scene_with(sensor, np.array([1.2, 1.8]))
    assert other.diffuser is not None
    values = other.diffuser.free_values
    np.testing.assert_allclose([values[name] for name in free.names], [1.2, 1.8])
    assert other.hash != sensor.hash
    assert family_hash(other, free.names) == family_hash(sensor, free.names)


def test_the_preview_between_materials_is_that_of_the_material(sensor: Scene) -> None:
    grid, left_out = draw_material_grid(sensor, 5, 3, materials=10)
    assert left_out is not None
    assert grid.free is not None
    material = np.array([1.25, 2.3])
    with Preview(grid.free.scene_with(sensor, material)) as preview:
        transport, background = preview.transport(grid.phi, grid.bends)
    exact = np.concatenate([transport, background[..., None]], axis=-1)
    error = np.abs(np.exp(at_material(grid, material)) / exact - 1.0)
    # Two slab responses of so few rays differ by about as much.
    assert np.median(error) < 2.0 * left_out.median
    assert left_out.median < 0.05
    with Preview(sensor) as preview:
        nominal = preview.transport(grid.phi, grid.bends)[0]
    assert np.median(np.abs(transport / nominal - 1.0)) > 2.0 * np.median(error)


def test_the_exported_model_takes_the_material(free_model: Trained, sensor: Scene) -> None:
    checker = Checker.for_scene(free_model.folder, sensor)
    session = onnxruntime.InferenceSession(str(free_model.folder / "checker.onnx"))
    assert [item.name for item in session.get_inputs()] == ["phi", "power", "bend", "material"]
    golden = np.load(free_model.folder / "golden.npz")
    feeds = {name: golden[name] for name in ("phi", "power", "bend", "material")}
    np.testing.assert_allclose(
        session.run(["counts"], feeds)[0], golden["counts"], rtol=1e-4, atol=1e-3
    )
    thin = MaterialRange.of(sensor).scene_with(sensor, np.array([0.7, 1.5]))
    other = Checker.for_scene(free_model.folder, thin)
    assert other.scene_hash == thin.hash
    design = np.full((1, 5), 1.2), np.full((1, 5, 3), 0.02), np.array([0.0])
    bright, own = (model.run(*design)["counts"].mean() for model in (other, checker))
    assert bright > 1.15 * own, "less scattering in a thinner layer lets more light through"


def test_the_residual_follows_the_material_and_is_examined_on_unseen_ones(sensor: Scene) -> None:
    free = MaterialRange.of(sensor)
    assert free is not None
    grid, _ = draw_material_grid(sensor, 7, 1, materials=8)
    materials, noise = free.samples(10), 0.02
    rng, tables = np.random.default_rng(0), []
    for material in materials:
        trend = np.exp(0.3 + 0.4 * free.unit(material) @ np.array([1.0, -0.5]))
        light = np.exp(at_material(grid, material)) * trend
        noisy = light * (1 + noise * rng.standard_normal(light.shape))
        tables.append(
            TransportTable(
                T=noisy[..., :-1], se=noise * light[..., :-1], phi=grid.phi, exposure=1.0, lam=1.0,
                scene_hash="", level="reference", bends=grid.bends,
                background=noisy[..., -1], background_se=noise * light[..., -1],
            )
        )  # fmt: skip
    cells = training_cells(sensor, tables, materials)
    network = NetworkConfig(width=8, steps=300, batch=256)
    config = FitConfig(members=3, network=network, penalties=(1e-4,), designs=60)
    task = FitTask(
        sensor, grid, cells, exposure=1e5, lam=10.0, bends=np.array([0]), seed=0, config=config
    )
    fit = fit_residual(task, lambda *_: None)
    levels = {row.name: row.facet_rms_true for row in (*fit.levels, *fit.splits)}
    assert levels[fit.kind] < 0.1 * levels["preview"]
    assert levels["unseen material"] < 0.5 * levels["preview"]


def test_a_material_beyond_the_range_raises_domain_excess(
    free_model: Trained, sensor: Scene
) -> None:
    free = MaterialRange.of(sensor)
    assert free is not None
    design = np.full((1, 5), 1.2), np.full((1, 5, 3), 0.02), np.array([0.0])
    for material, excess in (([1.4, 2.5], 0.0), ([1.4, 3.0], 0.5), ([2.8, 2.0], 1.0)):
        scene = free.scene_with(sensor, np.array(material))
        found = Checker.for_scene(free_model.folder, scene).run(*design)
        assert found["domain_excess"][0] == pytest.approx(excess, abs=1e-5)
    session = onnxruntime.InferenceSession(str(free_model.folder / "checker.onnx"))
    golden = np.load(free_model.folder / "golden.npz")
    feeds = {name: golden[name].copy() for name in ("phi", "power", "bend", "material")}
    feeds["material"][0, 0] = np.nan
    feeds["material"][1, 0] = -1.0
    counts, beyond = session.run(["counts", "domain_excess"], feeds)
    assert np.isnan(counts[:2]).all()
    assert np.isinf(beyond[:2]).all()
    assert np.isfinite(counts[2]).all()


def test_commands_warn_where_the_material_leaves_the_range(
    free_model: Trained, sensor: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    from optimize.scoring import open_model

    free = MaterialRange.of(sensor)
    assert free is not None
    open_model(free.scene_with(sensor, np.array([1.4, 2.5])), free_model.folder)
    assert capsys.readouterr().err == ""
    open_model(free.scene_with(sensor, np.array([1.0, 3.0])), free_model.folder)
    said = capsys.readouterr().err
    assert "diffuser_thickness 3 (trained 1.5 to 2.5)" in said
    assert "extrapolation" in said


def test_a_scene_that_differs_elsewhere_is_still_refused(
    free_model: Trained, sensor: Scene
) -> None:
    other = unchecked(sensor, {"pad": unchecked(sensor.pad, {"roughness": 0.2}), "free": None})
    with pytest.raises(ModelError, match="model of another scene"):
        Checker.for_scene(free_model.folder, other)


def test_one_table_is_not_enough_for_a_free_material(
    sensor: Scene, tmp_path: Path, quick: TrainConfig
) -> None:
    shape = (5, 2, 1, 2, 6)
    table = TransportTable(
        T=np.ones(shape), se=np.ones(shape), phi=np.array([0.0, np.pi]), exposure=1.0, lam=1.0,
        scene_hash=sensor.hash, level="reference", bends=np.array([0.0]),
    )  # fmt: skip
    with pytest.raises(TableError, match="train without a table"):
        train(sensor, tmp_path / "m", table=table, config=quick)
