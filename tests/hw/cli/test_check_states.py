"""``tactilux check --state`` on an emulated rig whose skin has states, by a model trained on it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hw.calibration.reference_lines import Setup
from hw.camera.photo_set import save_photos, take_sweep
from hw.emulator.emulated_board import EmulatedBoard
from hw.emulator.emulated_camera import CameraImperfections, EmulatedCamera
from hw.emulator.rig import TrueParameters, random_parameters, true_images
from hw.leds import ProtocolName
from hw.leds.channels import ChannelMap, PowerLimits
from hw.leds.fiber_lights import FiberLights
from hw.leds.ports import open_board
from optimize.design import baseline_design
from render.arrays import Array
from render.geometry import in_state
from render.scene import Scene
from surrogate.train import TrainConfig, train
from tests.conftest import Run
from tests.oracles.soft_domes import scene_text_of, write_files, written

pytestmark = pytest.mark.slow

Photographed = Callable[[str, str, Array], Path]
LAMPS = 6


@pytest.fixture(scope="module")
def dome(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    """Train a model of a dome at rest, pressed down by a twelfth, and twisted by a plate."""
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder, steps=16)
    scene = written(folder, scene_text_of("low", "twisted"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        train(scene, folder / "model", config=TrainConfig(samples=64, coarse=True))
    return scene, folder


@pytest.fixture(scope="module")
def photographed(
    dome: tuple[Scene, Path], tmp_path_factory: pytest.TempPathFactory
) -> Photographed:
    """Write sweeps of an emulated rig in a state, lamps at relative powers ``(lamp,)``."""
    (scene, _), folder = dome, tmp_path_factory.mktemp("sweeps")
    design, truth = baseline_design(scene), random_parameters(scene, 3)
    images: dict[str, Array] = {}

    def write(name: str, state: str, power: Array) -> Path:
        posed, _ = in_state(scene, float(scene.state_names.index(state)))
        if state not in images:
            images[state] = true_images(Setup(posed, design.phi, np.zeros(1)), truth)[0]
        save_photos(_sweep(posed, images[state], power, design.drive, truth, folder), folder / name)
        return folder / name

    return write


def _sweep(
    scene: Scene, images: Array, power: Array, drive: Array, truth: TrueParameters, folder: Path
) -> dict[str, Array]:
    with EmulatedBoard(folder / "port", ProtocolName.LINES, LAMPS) as board:
        connect = partial(open_board, str(board.port), ProtocolName.LINES, leds=LAMPS)
        limits = PowerLimits(total_milliamperes=2000)
        exposure = 150.0 / images.max()
        camera = EmulatedCamera(
            scene,
            images,
            board,
            exposure,
            power,
            CameraImperfections(gain=truth.imperfections.gain),
        )
        with FiberLights(connect, ChannelMap.straight(LAMPS), limits) as lights:
            return take_sweep(camera, lights, drive, frames=16, settle=0.0)


def checked(folder: Path) -> tuple[object, ...]:
    return "check", folder / "scene.toml", "--model", folder / "model"


def powers(**changed: float) -> Array:
    power = np.ones(LAMPS)
    for lamp, value in changed.items():
        power[int(lamp[1:])] = value
    return power


STATES = ("rest", "low", "twisted")


@pytest.mark.parametrize("state", STATES)
def test_a_rig_is_judged_in_the_state_that_its_skin_is_in(
    tactilux: Run, dome: tuple[Scene, Path], photographed: Photographed, state: str
) -> None:
    words = checked(dome[1])
    here = ("--state", state)
    healthy = photographed(f"{state}-healthy", state, powers())
    known = tactilux(*words, *here, "--capture", healthy, "--commission", "rig.npz")
    assert known.code == 0, known.out + known.err
    for name, power, told in (
        ("dead", powers(l4=0.0), "Fiber 4 is dead"),
        ("dim", powers(l1=0.5), "Fiber 1 is dim"),
    ):
        faulty = photographed(f"{state}-{name}", state, power)
        said = tactilux(*words, *here, "--capture", faulty, "--rig", "rig.npz")
        assert said.code == 1, said.out + said.err
        assert told in said.out
        assert said.out.count("Fiber ") == 1

    # A twist moves the skin aside, so a healthy rig does not pass in another state.
    for other in STATES:
        if other == state:
            continue
        refused = tactilux(*words, "--state", other, "--capture", healthy, "--rig", "rig.npz")
        assert refused.code == 2
        assert f"the rig's record was made for the state {state}: make a new one" in refused.err
        if "twisted" in (state, other):
            said = tactilux(*words, "--state", other, "--capture", healthy)
            assert said.code == 1
            assert "scene, design and state are those of the rig" in said.out


def test_without_a_state_the_skin_is_at_rest(
    tactilux: Run, dome: tuple[Scene, Path], photographed: Photographed
) -> None:
    words, healthy = checked(dome[1]), photographed("resting", "rest", powers())
    plain, named = (
        tactilux(*words, *more, "--capture", healthy, "--json")
        for more in ((), ("--state", "rest"))
    )
    assert plain.code == 0
    assert plain.out == named.out


@pytest.mark.parametrize(
    ("scene", "arguments", "said"),
    [
        ("scene.toml", ("--state", "bent"), "--state bent, allowed: rest, low, twisted"),
        ("scene.toml", ("--bend", "45"), "soft-dome does not bend, allowed: --state"),
        ("finger20", ("--state", "rest"), "--state rest: finger20 has no states, allowed: a scene"),
    ],
)
def test_a_state_that_the_scene_lacks_raises_one_clear_error(
    tactilux: Run, dome: tuple[Scene, Path], scene: str, arguments: tuple[str, str], said: str
) -> None:
    file = dome[1] / scene
    result = tactilux("check", file if file.exists() else scene, *arguments, "--capture", "x")
    assert result.code == 2
    assert result.out == ""
    assert said in result.err.splitlines()[-1]
