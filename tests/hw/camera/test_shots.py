"""An emulated rig plays the shots of a design, one picture each, and is checked like any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.camera.photo_reader import PhotoReader
from hw.camera.photo_set import save_photos, take_shots, take_sweep
from hw.check.diagnosis import FiberState
from hw.check.prediction import SiteSpots, predict
from hw.check.rig_tolerances import rig_tolerances
from hw.check.sweep_check import check_sweep
from hw.emulator.demonstration import EmulatedRig, single_exposure, switched_on
from hw.emulator.emulated_camera import CameraImperfections
from hw.emulator.rig import TrueParameters
from optimize.design import Design
from optimize.scoring import open_model
from render.scene import Scene, load_scene, unchecked
from surrogate.runtime import Checker

ROWS, COLUMNS = 180, 240


@pytest.fixture(scope="module")
def scene() -> Scene:
    shots = load_scene("digit").with_(camera_shots=2)
    return unchecked(shots, {"camera": unchecked(shots.camera, {"rows": ROWS, "columns": COLUMNS})})


def design_of(scene: Scene, *names: str) -> Design:
    colors = [scene.palette.index(name) for name in names]
    return Design.of_colors(np.full(scene.lamp_count, np.pi / 2), colors, scene.palette)


def images(scene: Scene) -> np.ndarray:
    """Return light that fades across the picture, another way for each lamp."""
    y, x = np.mgrid[0 : 1 : ROWS * 1j, 0 : 1 : COLUMNS * 1j].astype(np.float32)
    return np.stack([0.4 + 0.6 * x, 0.4 + 0.6 * y, 1.0 - 0.6 * x])[None]


def truth_of(scene: Scene, noise: float = 0.0) -> TrueParameters:
    camera = CameraImperfections(noise=noise)
    truth = TrueParameters(None, np.ones(3), np.zeros(3), 0.0, camera, 1)
    return replace(truth, gain=single_exposure(truth, images(scene)))


def test_each_shot_is_photographed_under_its_own_lights(scene: Scene) -> None:
    design = design_of(scene, "red@1", "green", "blue@2")
    with switched_on(scene, design, truth_of(scene), images(scene)) as rig:
        camera, palette = rig.camera(), scene.palette
        picture = take_shots(camera, rig.lights, palette.in_shots(design.drive))
        assert picture.shape == (ROWS, COLUMNS, 6)
        # Each channel of each shot is what its lamps alone make: light adds up.
        alone = take_sweep(camera, rig.lights, design.drive, palette, settle=0.0)
        dark = alone["dark"]
        assert dark.shape == picture.shape
        parts = sum(alone[f"fiber-{fiber:02d}"] - dark for fiber in range(3))
        assert np.abs(parts - (picture - dark)).max() <= 2.0
        assert np.array_equal(alone["all"], picture)
        seen = (picture - dark).mean(axis=(0, 1)) > 5.0
        # red-1, green-1, blue-1, red-2, green-2, blue-2
        assert seen.tolist() == [True, True, False, False, True, True]


def test_a_sweep_of_shots_is_saved_and_read_again(scene: Scene, tmp_path: Path) -> None:
    design = design_of(scene, "red@1", "green", "blue@2")
    with switched_on(scene, design, truth_of(scene), images(scene)) as rig:
        photos = take_sweep(rig.camera(), rig.lights, design.drive, scene.palette, settle=0.0)
    save_photos(photos, tmp_path / "sweep")
    found = PhotoReader(scene).sweep(tmp_path / "sweep")
    for fiber in range(3):
        true = photos[f"fiber-{fiber:02d}"] - photos["dark"]
        assert np.abs(found.alone[fiber] - true).max() < 0.02


@pytest.fixture(scope="module")
def checker(scene: Scene) -> Checker:
    return open_model(load_scene("digit").with_(camera_shots=2), coarse=True)


def diagnosed(rig: EmulatedRig, checker: Checker, shown: np.ndarray) -> list[FiberState]:
    """Return what the check says of each fiber when the board is told ``shown``."""
    spots, palette = SiteSpots(rig.scene, 0.0), rig.scene.palette
    known = predict(checker, rig.design.phi, rig.design.drive, 0.0, palette.matrix)
    # What the camera is shown is known exactly, so that the shots alone are looked at.
    sites = np.stack([spots.colors(one[..., None])[:, 0] for one in images(rig.scene)[0]])
    known = replace(known, table=np.repeat(sites[:, None], known.table.shape[1], axis=1))
    photos = rig.photos("sweep", rig.camera(), shown)
    noise = np.full((known.cells[1], len(palette.channels)), 0.2)
    tolerances = rig_tolerances(sweep=True, starts=0, noise=noise)
    found = check_sweep(known, photos.stacked(known.lit, spots.colors), tolerances)
    return [fiber.state for fiber in found.fibers]


def test_the_check_tells_a_lamp_that_misses_its_shot(scene: Scene, checker: Checker) -> None:
    design = design_of(scene, "red@1", "green", "blue@2")
    with switched_on(scene, design, truth_of(scene, noise=1.0), images(scene)) as rig:
        assert diagnosed(rig, checker, design.drive) == [FiberState.OK] * 3
        late = design_of(scene, "red@2", "green", "blue@2").drive
        states = diagnosed(rig, checker, late)
        assert states[0] is not FiberState.OK
        assert states[1:] == [FiberState.OK] * 2
