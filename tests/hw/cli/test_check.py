"""``tactilux check`` needs no renderer and no training, and its exit code tells the rig's state."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from optimize.cli import PACKAGES
from optimize.design import Design, baseline_design, save_design
from render.arrays import Array
from render.scene import load_scene
from surrogate.runtime import Checker
from tests.conftest import Run
from tests.hw.cli.conftest import ROOT

Photographed = Callable[[Path, Array], Path]

# What a robot's computer does not have: the packages of all extras.
ABSENT = tuple(itertools.chain.from_iterable(PACKAGES.values()))
BLOCKED = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"blocked: {{name}}", name=name)
sys.meta_path.insert(0, Block())
sys.argv = ["tactilux", *{arguments!r}]
from hw.cli import main
main()
"""


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory, photographed: Photographed) -> Path:
    """Write a healthy sweep."""
    return photographed(tmp_path_factory.mktemp("healthy") / "sweep", np.ones(20))


def baseline_score() -> float:
    checker = Checker.load(ROOT / "models" / "finger20", threads=2)
    design = baseline_design(load_scene("finger20"))
    bends = np.array(checker.metadata.scene_bends)
    return float(checker.run(design.phi[None], design.power[None], bends)["score"][0])


def blocked(*arguments: object) -> subprocess.CompletedProcess[str]:
    code = BLOCKED.format(absent=ABSENT, arguments=[str(item) for item in arguments])
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_it_runs_where_neither_torch_nor_a_renderer_is(sweep: Path) -> None:
    done = blocked("check", "--capture", sweep, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result) == {"ok", "score", "counts_error", "fibers", "domain_excess", "bands"}
    assert result["ok"] is True
    assert result["bands"] == []
    assert len(result["fibers"]) == 20
    assert {fiber["state"] for fiber in result["fibers"]} == {"ok"}
    assert result["score"] == pytest.approx(baseline_score(), abs=1e-3)


def test_a_fault_is_named_and_the_exit_code_is_1(
    tactilux: Run, tmp_path: Path, photographed: Photographed
) -> None:
    power = np.ones(20)
    power[4], power[13] = 0.0, 0.5
    result = tactilux("check", "--capture", photographed(tmp_path / "sweep", power))
    assert result.code == 1
    assert "Fiber 4 is dead" in result.out
    assert "Fiber 13 is dim" in result.out
    assert "about 50 %" in result.out


def test_a_record_of_the_healthy_rig_is_made_and_used(
    tactilux: Run, tmp_path: Path, sweep: Path
) -> None:
    assert tactilux("check", "--capture", sweep, "--commission", tmp_path / "rig.npz").code == 0
    result = tactilux("check", "--capture", sweep, "--rig", tmp_path / "rig.npz", "--json")
    assert result.code == 0
    assert json.loads(result.out)["counts_error"] < 0.5


def test_calibrated_powers_tell_a_dim_fiber_from_one_that_was_built_weak(
    tactilux: Run, tmp_path: Path, photographed: Photographed
) -> None:
    power = np.ones(20)
    power[7] = 0.6
    sweep = photographed(tmp_path / "sweep", power)
    assert "Fiber 7 is dim" in tactilux("check", "--capture", sweep).out
    content = {
        "scene_hash": {"before": load_scene("finger20").hash},
        "power": (power / power.mean()).tolist(),
        "power_error": [0.01] * 20,
    }
    calibration = tmp_path / "calibration.json"
    calibration.write_text(json.dumps(content))
    known = tactilux("check", "--capture", sweep, "--calibration", calibration)
    assert known.code == 0, known.out
    assert f"powers are those of {calibration}" in known.err
    power[7], power[3] = 1.0, 0.6
    changed = photographed(tmp_path / "changed", power)
    said = tactilux("check", "--capture", changed, "--calibration", calibration)
    assert said.code == 1
    assert "Fiber 3 is dim" in said.out


def test_a_record_grows_with_every_healthy_start(
    tactilux: Run, tmp_path: Path, sweep: Path
) -> None:
    record = tmp_path / "rig.npz"
    for start in (1, 2):
        result = tactilux("check", "--capture", sweep, "--commission", record)
        assert f"holds {start} start" in result.err
    result = tactilux("check", "--capture", sweep, "--rig", record)
    assert "holds 2 of 4 starts" in result.out
    other = tactilux("check", "--capture", sweep, "--bend", "20", "--commission", record)
    assert other.code != 0


def test_swapped_channels_raises_one_clear_error(
    tactilux: Run, tmp_path: Path, sweep: Path
) -> None:
    folder = tmp_path / "bgr"
    folder.mkdir()
    for path in sweep.iterdir():
        pixels = np.asarray(Image.open(path))[..., ::-1]
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / path.name, compress_level=1)
    result = tactilux("check", "--capture", folder)
    assert result.code == 2
    assert "red in B, green in G, blue in R" in result.err
    assert result.err.count("\n") == 1


def test_a_rig_with_a_fault_gets_no_record(
    tactilux: Run, tmp_path: Path, photographed: Photographed
) -> None:
    power = np.ones(20)
    power[9] = 0.4
    sweep = photographed(tmp_path / "sweep", power)
    result = tactilux("check", "--capture", sweep, "--commission", tmp_path / "rig.npz")
    assert result.code == 1
    assert not (tmp_path / "rig.npz").exists()


def test_one_image_of_all_fibers_will_do(
    tactilux: Run, tmp_path: Path, fiber_photos: Array
) -> None:
    together = fiber_photos.sum(axis=0)
    together *= 200 / together.max()
    for name, photo, code in (
        ("all.png", together, 0),
        ("dead.png", together - fiber_photos[4] * together.max() / fiber_photos.sum(0).max(), 1),
    ):
        Image.fromarray(np.rint(np.clip(photo, 0, 255)).astype(np.uint8)).save(tmp_path / name)
        result = tactilux("check", "--capture", tmp_path / name)
        assert result.code == code, result.out + result.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "nothing to look at: give either --capture"),
        (("--capture", "black.png", "--camera", "0"), "two things to look at: give either"),
        (("--capture", "glassy.png"), "it is transparent in places"),
        (("--capture", "none.png"), "cannot be read"),
        (("--capture", "empty"), "holds no sweep"),
        (("--capture", "small.png"), "allowed: 360 x 600"),
        (("--capture", "white.png"), "over-exposed"),
        (("--capture", "black.png"), "lens cap"),
        (("--capture", "some"), "no photograph of fiber"),
        (("--capture", "bright"), "room light"),
        (("--capture", "black.png", "--rig", "none.npz"), "does not exist"),
        (("--capture", "black.png", "--commission", "rig.npz"), "folder of a sweep"),
        (("--capture", "black.png", "--design", "none.json"), "design.json"),
    ],
)
def test_what_cannot_be_checked_raises_one_clear_error(
    tactilux: Run, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    def image(name: str, value: int, size: tuple[int, int] = (360, 600)) -> None:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        Image.new("RGB", size, (value, value, value)).save(path)

    (tmp_path / "empty").mkdir()
    image("small.png", 10, (36, 60))
    image("white.png", 255)
    image("black.png", 0)
    Image.new("RGBA", (360, 600), (9, 9, 9, 254)).save(tmp_path / "glassy.png")
    image("some/fiber-03.png", 50)
    image("bright/dark.png", 90)
    image("bright/fiber-00.png", 90)
    result = tactilux("check", *arguments)
    assert result.code == 2, result.out + result.err
    assert result.out == ""
    assert said in result.err
    assert result.err.count("\n") == 1
    assert "Traceback" not in result.err


def test_a_fiber_that_the_design_leaves_dark_needs_no_photograph(
    tactilux: Run, tmp_path: Path, photographed: Photographed
) -> None:
    scene = load_scene("finger20")
    design = baseline_design(scene)
    dark = Design.of_colors(design.phi, np.where(np.arange(20) == 6, -1, design.colors).tolist())
    save_design(tmp_path / "design.json", dark, scene)
    sweep, record = photographed(tmp_path / "sweep", np.ones(20)), tmp_path / "rig.npz"
    (sweep / "fiber-06.png").unlink()
    command = ["check", "--design", tmp_path / "design.json", "--capture", sweep]
    for more in (["--commission", record], ["--rig", record], []):
        result = tactilux(*command, *more)
        assert result.code == 0, result.out + result.err
        assert "The rig looks as designed.\nFiber 6 is not lit by the design.\n" in result.out
    (sweep / "fiber-13.png").unlink()
    missing = tactilux(*command, "--rig", record)
    assert missing.code == 2
    assert "no photograph of fiber 13 (1 is missing)" in missing.err
