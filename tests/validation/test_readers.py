"""Expected errors rank designs as the readers do; the sensor reader does as a trained network."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kendalltau

from optimize.design import Array, Design, dimmed_baseline
from optimize.objectives import READERS
from optimize.readers import (
    CameraModel,
    ExposedColors,
    expected_error,
    place_error,
    sensor_error,
)
from optimize.readers.normal_colors import colors_of_normals
from optimize.readers.normals import angle, plane_parts, random_normals, steepest, vectors
from optimize.readers.reading import read_normals
from optimize.readers.sensor_reader import site_places
from optimize.scoring import predicted_colors, trained_model
from render.scene import Scene, load_scene
from tests.long import LONG

SCENES = ["finger20", "gelsight-mini", "digit"]
SCENES += ["finger24", "gelsight-flat", "digit-dome"] if LONG else []
DESIGNS, SEEDS = 60, 4
NETWORKS = 24 if LONG else 12
CAMERA = CameraModel()
LEAST = {"sensor": (0.85, 0.08, 0.08), "place": (0.7, 0.25, 0.15)}
"""Tau of all designs, distance of the better half's ratio from 1, and its relative spread.

Three lamps (`digit`) make few different random designs: most read alike, and noise orders them.
"""


def exposed_designs(scene: Scene) -> list[ExposedColors]:
    """Return random designs: colors, powers and directions, and some near the baseline."""
    checker, rng = trained_model(scene), np.random.default_rng(0)
    assert checker is not None
    base, found = dimmed_baseline(scene), []
    count, choices = base.drive.shape
    for number in range(DESIGNS):
        phi = base.phi
        if any(scene.turning) and number % 2:
            phi = rng.uniform(0.3, 2.8, count)
        drive = np.eye(choices)[rng.integers(0, choices, count)]
        if number % 4 > 1:
            kept = rng.uniform(size=count) < 0.7
            drive[kept] = base.drive[kept]
        if number % 3 == 1:
            mixed = (number % 2) * rng.uniform(0.0, 0.5, drive.shape)
            drive = np.clip(drive * rng.uniform(0.2, 1.0, (count, 1)) + mixed, 0.0, 1.0)
        design = Design(phi, drive, scene.palette)
        found.append(ExposedColors.of(predicted_colors(checker, design), CAMERA))
    return found


def network_error(scene: Scene, exposed: ExposedColors, seed: int) -> float:
    """Return the error in degrees of a network of 2 x 64 on color and place, on fresh normals."""
    import torch

    states, sites = exposed.colors.shape[:2]
    rng, slope = np.random.default_rng([seed, 5]), steepest(scene)
    many = -(-9000 // (states * sites))

    def drawn(count: int) -> tuple[Array, Array]:
        normals = random_normals(rng, (states, sites, count))
        colors = colors_of_normals(exposed.colors, *normals)
        seen = CAMERA.recorded(colors, rng, exposed.gain) / 255.0
        place = np.broadcast_to(site_places(scene)[:, None], (states, sites, count, 2))
        inputs = np.concatenate([seen, place], axis=-1)
        return inputs.reshape(-1, inputs.shape[-1]), plane_parts(slope, *normals).reshape(-1, 2)

    known, taught = drawn(many)
    shown, truth = drawn(64)
    center, scale = known.mean(axis=0), known.std(axis=0) + 1e-3
    x, y, test = (
        torch.tensor(part, dtype=torch.float32)
        for part in ((known - center) / scale, taught / slope, (shown - center) / scale)
    )
    torch.manual_seed(seed)
    layers: list[torch.nn.Module] = []
    for size in (x.shape[1], 64):
        layers += [torch.nn.Linear(size, 64), torch.nn.Tanh()]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(64, 2))
    steps = torch.optim.Adam(network.parameters(), 3e-3)
    rounds = 100
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(steps, rounds)
    for _ in range(rounds):
        for batch in torch.randperm(len(x)).split(256):
            steps.zero_grad()
            ((network(x[batch]) - y[batch]) ** 2).mean().backward()
            steps.step()
        slower.step()
    with torch.no_grad():
        read = slope * network(test).numpy().astype(float)
    return float(angle(vectors(read), vectors(truth)).mean())


@pytest.mark.parametrize("name", SCENES)
def test_expected_errors_rank_designs_as_the_readers_do(name: str) -> None:
    scene = load_scene(name)
    designs = exposed_designs(scene)
    colors = np.stack([exposed.colors for exposed in designs])
    gain = np.array([exposed.gain for exposed in designs])
    read = [
        [read_normals(scene, exposed, exposed, CAMERA, seed) for seed in range(SEEDS)]
        for exposed in designs
    ]
    print(f"\n{name}: tau of the closed form with the reader, of all and of the better half; ratio")
    for reader in READERS:
        found = np.array([np.mean([getattr(e, reader).mean() for e in row]) for row in read])
        expected = expected_error(reader, scene, CAMERA).exposed_degrees(colors, gain)
        better = found < np.median(found)
        tau = kendalltau(expected, found)[0], kendalltau(expected[better], found[better])[0]
        logarithm = np.log(expected[better] / found[better])
        ratio, spread = float(np.exp(np.median(logarithm))), float(logarithm.std())
        print(f"  {reader}: {tau[0]:.3f}, {tau[1]:.3f}; {ratio:.3f} +- {spread:.3f}")
        least, off, most = LEAST[reader]
        assert tau[0] >= least
        assert ratio == pytest.approx(1.0, abs=off)
        assert spread <= most


@pytest.mark.parametrize("name", SCENES)
def test_more_normals_change_little(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(name)
    designs = exposed_designs(scene)[:24]
    colors = np.stack([exposed.colors for exposed in designs])
    gain = np.array([exposed.gain for exposed in designs])
    print(f"\n{name}: few normals over many, tau of both")
    for module, reader, many in ((sensor_error, "sensor", 64), (place_error, "place", 48)):
        few = expected_error(reader, scene, CAMERA).exposed_degrees(colors, gain)
        with monkeypatch.context() as patch:
            patch.setattr(module, "NORMALS", many)
            more = expected_error(reader, scene, CAMERA).exposed_degrees(colors, gain)
        ratio, tau = float(np.median(few / more)), kendalltau(few, more)[0]
        print(f"  {reader}: {ratio:.3f}, {tau:.3f}")
        assert ratio == pytest.approx(1.0, abs=0.07)
        assert tau >= 0.8


@pytest.mark.parametrize("name", SCENES if LONG else SCENES[1:2])
def test_the_sensor_reader_ranks_designs_as_a_trained_network_does(name: str) -> None:
    scene = load_scene(name)
    designs = exposed_designs(scene)[:NETWORKS]
    reader, network = [], []
    for exposed in designs:
        errors = [read_normals(scene, exposed, exposed, CAMERA, seed) for seed in range(2)]
        reader.append(np.mean([e.sensor.mean() for e in errors]))
        network.append(network_error(scene, exposed, 0))
    tau = kendalltau(reader, network)[0]
    print(
        f"\n{name}: tau {tau:.3f}, network over reader {np.median(np.divide(network, reader)):.2f}"
    )
    assert tau >= 0.8
