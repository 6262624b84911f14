"""The angle of half intensity, which data sheets have, says what sigma_v does."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hw.calibration.calibration import _put
from render.errors import SceneError
from render.geometry import fiber_poses
from render.scene import Profile, Scene, load_scene, scene_text, sources

Run = Callable[..., Any]
SIGMA = '{ value = 15.0, unit = "deg", source = "assumed" }'
SHEET = '{ value = %s, unit = "deg", source = "data sheet" }'
HEADER = "x,y,z,direction_x,direction_y,direction_z,diameter,"


def written(folder: Path, width: str, name: str = "finger20") -> Path:
    """Write a shipped scene whose first beam has another ``width``, key and value."""
    text = scene_text(name)
    assert f"sigma_v = {SIGMA}" in text
    path = folder / f"{name}.toml"
    path.write_text(text.replace(f"sigma_v = {SIGMA}", width, 1))
    return path


@pytest.mark.parametrize("degrees", [0.2, 5.0, 23.4, 30.0, 45.0, 56.0])
def test_intensity_falls_to_a_half_there(tmp_path: Path, degrees: float) -> None:
    scene = load_scene(written(tmp_path, f"half_angle = {SHEET % degrees}"))
    profile = scene.fibers.rows()[0].profile  # type: ignore[union-attr]
    assert profile.shape(np.radians(degrees)) == pytest.approx(0.5)
    assert profile.sentence.endswith(f"half intensity at {degrees:.3g} deg")


def test_it_is_the_intensity_of_the_beam_that_previews_and_renders_have(tmp_path: Path) -> None:
    """Of a disk that shines so, the light through small rings falls to a half there."""
    scene = load_scene(written(tmp_path, f"half_angle = {SHEET % 30}"))
    rng, width = np.random.default_rng(3), scene.fibers.sigma_v  # type: ignore[union-attr]
    theta = np.arccos(rng.uniform(0.0, 1.0, 400_000))
    radiance = np.exp(-((theta / (2 * width)) ** 2))
    power = radiance * np.cos(theta)  # through a unit of solid angle, of a flat end

    def near(degrees: float) -> float:
        return float(power[np.abs(theta - math.radians(degrees)) < 0.02].mean())

    assert near(30.0) / near(1.15) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("name", ["finger20", "finger24"])
def test_both_keys_make_one_sensor(tmp_path: Path, name: str) -> None:
    shipped = load_scene(name)
    width = shipped.lamp_rows[0].profile.sigma_v
    assert width is not None
    # 23.386 deg, to the last bit of what the width comes back to.
    low, high = 23.0, 24.0
    for _ in range(60):
        middle = (low + high) / 2
        wide = Profile.model_construct(sigma_v=width).shape(np.radians(middle)) > 0.5
        low, high = (middle, high) if wide else (low, middle)
    scene: Scene = load_scene(written(tmp_path, f"half_angle = {SHEET % repr(low)}", name))
    assert scene.lamp_rows[0].profile.sigma_v == pytest.approx(width, rel=1e-9)
    assert len(fiber_poses(scene, 0.0).position) == scene.lamp_count


def test_a_hash_knows_the_beam_and_not_the_key(tmp_path: Path) -> None:
    by_angle = load_scene(written(tmp_path, f"half_angle = {SHEET % 30}"))
    width = math.degrees(by_angle.fibers.sigma_v)  # type: ignore[union-attr]
    by_width = load_scene(written(tmp_path, f"sigma_v = {SHEET % repr(width)}"))
    assert by_angle.hash == by_width.hash
    assert load_scene("finger20").hash == "68471ad4c129ea4d"


@pytest.mark.parametrize(
    ("width", "sentence"),
    [
        (f"half_angle = {SHEET % 60}", "half_angle = 60: allowed: 0.2 to 56 deg "
         r'\("lambertian" has 60 deg; some data sheets give twice the angle\)'),
        ("half_angle = " + SHEET % '"wide"', 'half_angle = "wide", allowed: a number'),
        ("half_angle = 30.0", "half_angle = 30.0: must have the form"),
        (f"half_angle = {SHEET % 30}\nsigma_v = {SIGMA}",
         "half_angle = 30 deg: allowed: half_angle or sigma_v, not both"),
        (f"half_angel = {SHEET % 30}", "unknown key fibers.half_angel, did you mean half_angle?"),
        ("", "missing key fibers.sigma_v or half_angle"),
    ],
)  # fmt: skip
def test_what_it_cannot_be_is_told_by_its_name(tmp_path: Path, width: str, sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence.replace("angle?", r"angle\?")):
        load_scene(written(tmp_path, width))


def test_its_source_is_told_with_it(tactilux: Run, tmp_path: Path) -> None:
    path = written(tmp_path, f"half_angle = {SHEET % 30}")
    assert sources(path)["fibers.sigma_v"] == "data sheet (half_angle 30 deg)"
    assert sources(path).keys() == sources("finger20").keys()
    said = tactilux("describe", path)
    assert "20.2388 deg  data sheet (half_angle 30 deg)" in said.out


def test_lines_of_a_lamps_file_have_it_too(tmp_path: Path) -> None:
    text = scene_text("digit")
    head = text.index("[[lamps]]")
    rest = text.index("\n[", text.rindex("[[lamps]]") + 9)
    (tmp_path / "lamps.csv").write_text(HEADER + "half_angle\n0,-12,1,0,1,0.5,0.5,30\n")
    listed = text[:head].replace("\n[pad]", '\nlamps_file = "lamps.csv"\n\n[pad]', 1) + text[rest:]
    path = tmp_path / "digit.toml"
    path.write_text(listed.replace('lamps = ["green", "red"]', 'lamps = ["green"]', 1))
    profile = load_scene(path).lamps[0].profile  # type: ignore[index]
    assert profile.shape(np.radians(30.0)) == pytest.approx(0.5)


def test_a_calibrated_width_takes_its_place() -> None:
    raw: dict[str, Any] = {"fibers": {"half_angle": {"value": 30.0, "unit": "deg", "source": "x"}}}
    _put(raw, ("fibers", "sigma_v"), 17.0, "calibrated")
    assert raw == {"fibers": {"sigma_v": {"value": 17.0, "unit": "deg", "source": "calibrated"}}}


def test_a_beam_is_varied_by_either_of_its_angles() -> None:
    scene = load_scene("finger20")
    wider = scene.with_(fibers_half_angle=25.0)
    assert wider.hash != scene.hash
    assert wider.with_(fibers_sigma_v=15.0).hash == scene.hash
