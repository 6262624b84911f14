"""IES files: closed forms and means worked by hand, and everything the standard does not know."""

from __future__ import annotations

import numpy as np
import pytest

from render.ies_file import read_ies

HEAD = "1 -1 1 {n} {p} 1 2 0 0 0\n1 1 14\n"


def ies(
    angles: str,
    candela: str,
    planes: str = "0",
    *,
    tilt: str = "TILT=NONE",
    head: str = HEAD,
    label: str = "IESNA:LM-63-2002",
) -> str:
    """Return a file of angles, planes and values as they are written."""
    counts = head.format(n=len(angles.split()), p=len(planes.split()))
    return f"{label}\n[TEST] x\n{tilt}\n{counts}{angles}\n{planes}\n{candela}\n"


ROUND = ies("0 30 60 90", "100.5 80.2 30.1 0")


def lumens(text: str) -> float:
    """Return the integral of candela over the sphere, in steps of a thousandth of a degree."""
    degrees, candela = read_ies(text)
    fine = np.radians(np.linspace(degrees[0], degrees[-1], 180_001))
    of = np.interp(np.degrees(fine), degrees, candela)
    return float(2 * np.pi * np.trapezoid(of * np.sin(fine), fine))


def test_a_lambertian_lamp_has_pi_times_its_candela_in_lumens() -> None:
    angles = np.arange(0.0, 90.5, 1.0)
    values = " ".join(f"{100 * np.cos(np.radians(a)):.6f}" for a in angles)
    text = ies(" ".join(f"{a:g}" for a in angles), values)
    assert lumens(text) == pytest.approx(100 * np.pi, rel=1e-4)
    assert lumens(text.replace("1 -1 1 ", "1 -1 2.5 ")) == pytest.approx(250 * np.pi, rel=1e-4)


@pytest.mark.parametrize(
    "text",
    [
        ies("0 30 60 90", "100.5,80.2,30.1,0"),
        ies("0, 30, 60, 90", "100.5, 80.2, 30.1, 0"),
        ies("0 30\n60 90", "100.5\n80.2 30.1\n0"),
        ROUND.replace("\n", "\n\n") + "\x1a",
        ies("0 30 60 90", "100.5 80.2 30.1 0", label="IESNA91"),
        ies("0 30 60 90", "100.5 80.2 30.1 0", label="IES:LM-63-2019"),
        ies("0 30 60 90", "100.5 80.2 30.1 0", label="a laboratory, 1986"),
        ies("0 30 60 90", "100.5 80.2 30.1 0", tilt="tilt=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8"),
        ies("0 30 60 90", "100.5 80.2 30.1 0", tilt="TILT=lamp.tlt"),
        ies("90 120 150 180", "0 30.1 80.2 100.5"),
        ies("0 90 120 150 180", "0 0 30.1 80.2 100.5"),
        ROUND.replace("1 1 14", "0.85 1.10002 14"),
        ROUND.replace("1 -1 1 4 1 1 2 0 0 0", "2 1500 1.0 4 1 1 1 -0.1 0 0.5"),
    ],
)
def test_one_beam_is_the_same_in_every_form_of_the_standard(text: str) -> None:
    degrees, candela = read_ies(text)
    lit = np.searchsorted(degrees, 90.0) + 1
    np.testing.assert_allclose(degrees[:lit], [0, 30, 60, 90])
    np.testing.assert_allclose(candela[:lit], [100.5, 80.2, 30.1, 0])
    assert not candela[lit:].any()


@pytest.mark.parametrize(
    ("planes", "means"),
    [
        # The plane at 30 deg stands for half the quarter, that at 90 for a third, 0 for a sixth.
        ("0 30 90", (100 / 6 + 103 / 2 + 106 / 3)),
        # Both ends of the turn are one plane.
        ("0 180 360", (0.25 * 100 + 0.5 * 103 + 0.25 * 106)),
        ("0 45 180", (0.125 * 100 + 0.5 * 103 + 0.375 * 106)),
        ("90 135 270", (0.125 * 100 + 0.5 * 103 + 0.375 * 106)),
    ],
)
def test_planes_count_by_the_part_of_the_turn_that_they_stand_for(
    planes: str, means: float
) -> None:
    _, candela = read_ies(ies("0 90", "100 0\n103 0\n106 0", planes))
    assert candela == pytest.approx([means, 0.0])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (ies("0 30 60 90", "100,5 80,2 30,1 0,0"), "it has decimal commas (100,5), allowed"),
        (ies("0 90", "100 0", head="1 -1 1,0 {n} {p} 1 2 0,1 0,1 0\n0,9 1 14\n"), "decimal commas"),
        (ies("0 30 60 90", "100,5 80,2 30,1 0,0 7"), "the comma of 100,5 separates two numbers"),
        (ROUND + "77 12\n", "it has 2 values behind its 4 intensities, the first is '77'"),
        (ROUND + "END\n", "1 value behind its 4 intensities, the first is 'END'"),
        (ROUND.replace("1 2 0", "2 2 0"), "its photometric type is 2 (B), allowed: 1"),
        (ROUND.replace("1 2 0", "3 2 0"), "its photometric type is 3 (A), allowed: 1"),
        (ROUND.replace("1 2 0", "1 3 0"), "units is 3, allowed: 1 (feet) or 2 (meters)"),
        (ROUND.replace("1 -1 1 4", "1 -1 0 4"), "its multiplier of candela is 0, allowed: above 0"),
        (ROUND.replace("1 -1 1 4", "1 -1 -2 4"), "its multiplier of candela is -2"),
        (ROUND.replace("1 -1 1 4", "0 -1 1 4"), "its number of lamps is 0"),
        (ROUND.replace("1 -1 1 4", "1 -2 1 4"), "its lumens per lamp is -2, allowed: above 0"),
        (ROUND.replace("1 -1 1 4", "1 -1 1 1e9"), "its number of vertical angles is 1e+09"),
        (ROUND.replace("1 1 14", "0 1 14"), "its ballast factor is 0, allowed: above 0"),
        (ROUND.replace("1 1 14", "1 1 -14"), "its input watts is -14"),
        (ies("0 30 60", "100 80 0"), "its vertical angles go from 0 to 60 deg, allowed: 0 to 90"),
        (ies("-90 0 90", "0 100 0"), "its vertical angles go from -90 to 90 deg"),
        (ies("0 60 30 90", "100 80 30 0"), "its vertical angles do not rise"),
        (ies("0 90", "100 0\n100 0", "0 270"), "its angles of planes go from 0 to 270 deg"),
        (ies("0 90", "100 0", "45"), "its angles of planes go from 45 to 45 deg, allowed: 0, 0 to"),
        (ies("0 90", "100 0\n50 0", "0 90"), "its planes differ"),
        (ies("0 90", "100 0", tilt="TILT=INCLUDE\n4\n2\n0 90\n1 1"), "geometry 4 and 2 angles"),
        (ies("0 90", "100 0", tilt="TILT=INCLUDE\n1\n9\n0 90\n1 1"), "ends too early"),
        (ies("0 90", "100 0", tilt="TILT="), "it says nothing behind TILT="),
        (ies("0 90", "100 0", tilt="[OTHER] TILT=NONE"), "there is no line TILT="),
        (ies("0 90", "1_00 0"), "'1_00' stands where a number belongs"),
        (ies("0 90", "nan 0"), "'nan' stands where a number belongs"),
    ],
)  # fmt: skip
def test_what_the_standard_does_not_know_is_named(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=r"it|belongs") as caught:
        read_ies(text)
    assert why in str(caught.value)
