"""``tactilux check`` judges a rig alike in all forms of its photographs, or names what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from render.arrays import Array
from tests.conftest import Run

Photographed = Callable[[Path, Array], Path]


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory, photographed: Photographed) -> dict[str, Path]:
    """Write a healthy sweep, and one in which fiber 4 is dead and fiber 13 dim."""
    folder, faulty = tmp_path_factory.mktemp("sweeps"), np.ones(20)
    faulty[4], faulty[13] = 0.0, 0.5
    return {
        "healthy": photographed(folder / "healthy", np.ones(20)),
        "faulty": photographed(folder / "faulty", faulty),
    }


def resaved(sweep: Path, folder: Path, save: Callable[[Array, Path], None]) -> Path:
    folder.mkdir()
    for path in sweep.glob("*.png"):
        save(np.asarray(Image.open(path)), folder / path.stem)
    return folder


@pytest.mark.parametrize("quality", [95, 75])
def test_a_jpeg_is_judged_as_its_rig_is(
    tactilux: Run, tmp_path: Path, sweeps: dict[str, Path], quality: int
) -> None:
    def jpeg(pixels: Array, path: Path) -> None:
        Image.fromarray(pixels).save(f"{path}.jpg", quality=quality)

    healthy = tactilux("check", "--capture", resaved(sweeps["healthy"], tmp_path / "a", jpeg))
    assert healthy.code == 0, healthy.out
    faulty = tactilux("check", "--capture", resaved(sweeps["faulty"], tmp_path / "b", jpeg))
    assert faulty.code == 1
    said = [line for line in faulty.out.splitlines() if line.startswith("Fiber")]
    assert [line[:13] for line in said] == ["Fiber 4 is de", "Fiber 13 is d"]


def test_twelve_bits_are_judged_and_refused_as_eight_are(
    tactilux: Run, tmp_path: Path, sweeps: dict[str, Path]
) -> None:
    def deep(factor: float) -> Callable[[Array, Path], None]:
        def save(pixels: Array, path: Path) -> None:
            # Of eight bits in sixteen the last ones are noise.
            fine = pixels * (4095 / 255) + np.arange(pixels.size).reshape(pixels.shape) % 7
            np.save(f"{path}.npy", np.minimum(factor * fine, 4095).astype(np.uint16))

        return save

    faulty = tactilux("check", "--capture", resaved(sweeps["faulty"], tmp_path / "a", deep(0.9)))
    assert faulty.code == 1
    assert "full scale is taken to be 4095" in faulty.err
    assert faulty.out.startswith("Fiber 4 is dead")
    clipped = tactilux("check", "--capture", resaved(sweeps["healthy"], tmp_path / "b", deep(8.0)))
    assert clipped.code == 2
    assert "is over-exposed in" in clipped.err


WAYS = [
    (lambda p: p[::-1, ::-1], "upside down"),
    (lambda p: p[:, ::-1], "mirrored left to right"),
    (lambda p: p[::-1], "mirrored top to bottom"),
]


@pytest.mark.parametrize(("way", "said"), WAYS)
def test_a_sweep_that_is_turned_is_named_even_where_a_fiber_is_dead(
    tactilux: Run, tmp_path: Path, sweeps: dict[str, Path], way: Callable[[Array], Array], said: str
) -> None:
    def turned(pixels: Array, path: Path) -> None:
        Image.fromarray(np.ascontiguousarray(way(pixels))).save(f"{path}.png", compress_level=1)

    result = tactilux("check", "--capture", resaved(sweeps["faulty"], tmp_path / "a", turned))
    assert result.code == 2
    assert f"the photographs are {said}, allowed: row 0 towards the tip" in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize(("way", "said"), WAYS)
def test_one_photograph_that_is_turned_is_named(
    tactilux: Run, tmp_path: Path, fiber_photos: Array, way: Callable[[Array], Array], said: str
) -> None:
    together = fiber_photos.sum(axis=0)
    pixels = np.rint(way(together * 200 / together.max())).astype(np.uint8)
    Image.fromarray(np.ascontiguousarray(pixels)).save(tmp_path / "all.png")
    result = tactilux("check", "--capture", tmp_path / "all.png")
    assert result.code == 2
    assert f"the photographs are {said}" in result.err
    assert result.err.count("\n") == 1
