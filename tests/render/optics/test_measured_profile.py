"""Profiles of measured light: what is read from files, and how directions follow it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from render.errors import RenderError
from render.optics.measured_profile import measured_density, sample_measured
from render.scene.measured_profile import STEPS, MeasuredProfile

LAMBERT = "\n".join(f"{d}; {1000 * np.cos(np.radians(d)):.6f}" for d in range(91))
IES = """IESNA:LM-63-2002
[TEST] none
[MANUFAC] somebody
TILT=NONE
1 1000 2.0 4 2 1 2 0.1 0.1 0
1.0 1.0 20.0
0 30 60
90
0 90
100 80 20 0
100 82 19 0
"""


def written(folder: Path, text: str, name: str = "led.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_table_of_a_lambertian_lamp_is_read_as_one_of_unit_power(tmp_path: Path) -> None:
    profile = MeasuredProfile.read(written(tmp_path, "angle;candela\n" + LAMBERT))
    np.testing.assert_allclose(
        profile.intensity, np.cos(profile.theta) / np.pi, rtol=1e-4, atol=1e-6
    )


def test_an_ies_file_gives_the_mean_of_its_planes(tmp_path: Path) -> None:
    profile = MeasuredProfile.read(written(tmp_path, IES, "led.ies"))
    np.testing.assert_allclose(np.degrees(profile.theta), [0, 30, 60, 90])
    ratio = profile.intensity / profile.intensity[0]
    np.testing.assert_allclose(ratio, [1.0, 0.81, 0.195, 0.0])


def test_the_flux_of_all_steps_is_that_of_the_profile(tmp_path: Path) -> None:
    flux = MeasuredProfile.read(written(tmp_path, LAMBERT)).step_flux()
    assert flux.sum() == pytest.approx(1.0)
    edges = np.linspace(0, np.pi / 2, STEPS + 1)
    np.testing.assert_allclose(flux, np.diff(np.sin(edges) ** 2), rtol=2e-3, atol=1e-8)


def test_directions_are_drawn_as_often_as_their_density_says(
    mono: ModuleType, tmp_path: Path
) -> None:
    flux = MeasuredProfile.read(written(tmp_path, "0 1\n10 2\n30 1.5\n60 0.3\n80 0\n")).step_flux()
    table = mono.Float(np.append(0.0, np.cumsum(flux)).astype(np.float32))
    rng = np.random.default_rng(1)
    u, v = (mono.Float(rng.random(1 << 18).astype(np.float32)) for _ in range(2))
    local = np.array(sample_measured(u, v, table, mono.UInt32(0)))
    np.testing.assert_allclose(np.linalg.norm(local, axis=0), 1.0, atol=1e-5)
    theta = np.arccos(local[2])
    edges = np.radians(np.linspace(0, 90, 19))
    counts, _ = np.histogram(theta, edges)
    fine = (np.linspace(0, np.pi / 2, 18 * 400 + 1)[:-1] + np.pi / (4 * 18 * 400)).astype(
        np.float32
    )
    pdf = np.array(measured_density(mono.Float(fine), table, mono.UInt32(0)), dtype=np.float64)
    expected = (pdf * 2 * np.pi * np.sin(fine)).reshape(18, 400).sum(axis=1) * np.pi / (2 * 7200)
    assert expected.sum() == pytest.approx(1.0, abs=1e-4)
    spread = np.sqrt(theta.size * expected) + 1
    assert (np.abs(counts - theta.size * expected) < 5 * spread).all()
    assert counts[16:].sum() == 0


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("led.csv", "0,1\n10,-1\n", "negative"),
        ("led.csv", "0,1\n10,nan\n", "not finite"),
        ("led.csv", "0,1\n", "at least two"),
        ("led.csv", "0,1\n20,1\n10,1\n", "must rise"),
        ("led.csv", "5,1\n10,1\n", "first angle is 5 deg"),
        ("led.csv", "0,1\n90,1\n120,1\n", "beyond 90 deg"),
        ("led.csv", "0,0\n10,0\n", "dark"),
        ("led.csv", "0,1,2\n10,1,2\n", "each line needs"),
        ("led.csv", "zero,one\ntwo,three\n", "'two' stands where a number belongs"),
        ("led.csv", "0,1\n10\n", "each line needs an angle in degrees and an intensity, not '10'"),
        ("led.csv", "", "at least two"),
        ("led.ies", "TILT=NONE", "lacks 13 of the 13 numbers of the lamp"),
        ("led.ies", IES[: IES.index("0 30 60")] + "0 30", "lacks 2 of the 4 vertical angles"),
        ("led.ies", IES[: IES.index("100 80")], r"lacks 8 of the 8 intensities \(4 angles in 2 pl"),
        ("led.ies", IES[: IES.index("19 0")], "lacks 2 of the 8 intensities"),
        ("led.ies", IES.replace(" 4 2 1", " 4.5 2 1"), "vertical angles is 4.5, allowed: a whole"),
        ("led.ies", IES.replace(" 4 2 1", " inf 2 1"), "'inf' stands where a number belongs"),
        ("led.ies", IES.replace("82", "oh"), "'oh' stands where a number belongs"),
        ("led.ies", "0,1\n10,1\n", "no IES file"),
        ("led.ies", IES.replace("82", "20"), "planes differ"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_what_is_wrong(
    tmp_path: Path, name: str, text: str, why: str
) -> None:
    with pytest.raises(RenderError, match=f"{name} cannot be used: .*{why}") as caught:
        MeasuredProfile.read(written(tmp_path, text, name))
    assert caught.value.field == "filename"


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"led\.csv cannot be used: it cannot be read: No such"):
        MeasuredProfile.read(tmp_path / "led.csv")
