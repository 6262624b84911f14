"""Level 2 on pads of all kinds against analog photons: every facet and untouched site, absolutely.

The photons are kept (`tests.oracles.kept_photons`).

From the command line, with ratios and z scores per case, against other photons if it is told how
many: ``python -m tests.validation.test_clear_pads [--samples N] [--photons N] [CASE ...]``.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from render.errors import RenderError
from render.reference import render_transport
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.kept_photons import PHI, WHOLE, analog, photons_kept, traced
from tests.oracles.pads import REFUSED, scene_of_case
from tests.validation.film import not_too_many

SAMPLES = 4000 if LONG else 400
REPLICATES = 16
FEW_CELLS = 8

FAST = (
    "smooth", "narrow", "below touching", "rough 0.03", "no face", "half below", "rim rough 0.1",
    "rough left and lower, smooth tip", "rim on left and right rough 0.1", "dome",
    "row nearer than wide", "lobe", "lobe rough 0.1", "lobe of a dome", "cast in",
    "cast into a rim rough 0.1", "mixed 5", "mixed 20", "window lit at its edges",
    "window of low index under the lamps", "window with white walls",
)  # fmt: skip

BENT = "smooth bent 45"
"""A pad whose dimmest facets have bars that are too short."""


RENDERED = [case for case in WHOLE if case != BENT and case not in REFUSED]


class Comparison(NamedTuple):
    """Cells over analog cells: the ratio of sums with its error, and a z score per cell."""

    ratio: float
    error: float
    median: float
    z: np.ndarray
    p: np.ndarray
    cell_error: float
    oracle_error: float


def compare(replicates: np.ndarray, se: np.ndarray, oracle: np.ndarray) -> Comparison:
    """Hold rendered cells against the oracle's.

    Arguments:
        replicates: ``(replicate, cell)`` rendered.
        se: ``(cell,)`` their stated standard errors.
        oracle: ``(batch, cell)`` of analog photons.
    """
    seen = np.isfinite(replicates).all(axis=0) & np.isfinite(oracle).all(axis=0)
    replicates, se, oracle = replicates[:, seen], se[seen], oracle[:, seen]
    T, truth = replicates.mean(axis=0), oracle.mean(axis=0)
    truth_se = stats.sem(oracle, axis=0)
    # Where few photons arrive, their spread says little of the error.
    known = truth_se < 0.25 * truth
    if not known.any():
        known = truth > 0
    z = ((T - truth) / np.hypot(se, truth_se))[known]
    sums, truths = replicates.sum(axis=1), oracle.sum(axis=1)
    ratio = sums.mean() / truths.mean()
    return Comparison(
        ratio=float(ratio),
        error=float(
            ratio * np.hypot(stats.sem(sums) / sums.mean(), stats.sem(truths) / truths.mean())
        ),
        median=float(np.median(T[known] / truth[known])),
        z=z,
        p=2 * stats.t.sf(np.abs(z), min(len(replicates), len(oracle)) - 1),
        cell_error=float(np.median(se[known] / truth[known])),
        oracle_error=float(np.median(truth_se[known] / truth[known])),
    )


def compared(case: str, samples: int = SAMPLES, photons: int | None = None) -> list[Comparison]:
    """Render a case and return the comparison of its facets and of its sites.

    Arguments:
        case: of `tests.oracles.pads`.
        samples: per cell.
        photons: of each lamp, traced with another seed; those that are kept where None.
    """
    scene = scene_of_case(case)
    bend = np.array(scene.bending.angles[:1])
    estimate = render_transport(
        scene, np.array([PHI]), bend, samples=samples, replicates=REPLICATES
    )
    found = []
    for name, replicates, se in (
        ("facets", estimate.replicates, estimate.se),
        ("sites", estimate.background_replicates, estimate.background_se),
    ):
        pressed = name == "facets"
        if photons is None:
            oracle = photons_kept(case, pressed)
        else:
            oracle = traced(analog(scene, pressed, seed=2), photons)
        result = compare(
            replicates.reshape(REPLICATES, -1), se.ravel(), oracle.reshape(len(oracle), -1)
        )
        found.append(result)
        print(
            f"{case:28s} {name:6s} ratio {result.ratio:.4f} +- {result.error:.4f} "
            f"({(result.ratio - 1) / result.error:+6.1f} sigma); per cell: "
            f"median {result.median:.3f}, error {result.cell_error:6.1%} "
            f"(oracle {result.oracle_error:.1%}), rms z {np.sqrt((result.z**2).mean()):6.2f}, "
            f"largest {np.abs(result.z).max():6.1f}, "
            f"beyond 95 %: {(result.p < 0.05).mean():4.0%}",
            flush=True,
        )
    return found


@pytest.mark.parametrize("case", RENDERED if LONG else FAST)
def test_facets_and_sites_are_as_bright_as_analog_photons_say(case: str) -> None:
    for result in compared(case):
        assert abs(result.ratio - 1) < 3.5 * result.error + 0.002
        assert result.error < 0.05
        assert result.p.min() * result.p.size > 1e-3
        assert not_too_many(result.p)
        # A pad may show one lit site alone: of so few the median says nothing.
        assert len(result.z) < FEW_CELLS or np.median(np.abs(result.z)) < 1.5


def test_a_smooth_bent_pad_is_right_but_for_the_bars_of_one_facet_in_fifty() -> None:
    """One of 40,000 photons meets these, half of them by an image of the lamp over an end."""
    for result in compared(BENT):
        assert abs(result.ratio - 1) < 3.5 * result.error + 0.002
        assert result.error < 0.05
        assert np.sqrt((result.z**2).mean()) < 1.7
        assert (result.p * result.p.size < 1e-3).mean() <= 0.02
        assert not_too_many(result.p)
        assert np.median(np.abs(result.z)) < 1.5


def test_a_rough_wall_lights_facets_over_smooth_faces() -> None:
    """Half of what facets that face the wall get comes over the lower face and other walls."""
    case = "index 1.7, rough base"
    scene = scene_of_case(case)
    estimate = render_transport(scene, np.array([PHI]), np.zeros(1), samples=800, replicates=16)
    facing = AnalogScene(scene).pad.normal[:, 1] < -0.1
    assert 2 <= facing.sum() <= 4
    shape = (16, scene.sites.count, scene.indenter.faces)
    found, truth = (
        each.reshape(shape)[..., facing].sum(axis=(1, 2))
        for each in (estimate.replicates, photons_kept(case, pressed=True))
    )
    error = np.hypot(stats.sem(found), stats.sem(truth))
    assert error < 0.05 * truth.mean()
    assert found.mean() == pytest.approx(truth.mean(), abs=3.5 * error + 0.02 * truth.mean())


def test_light_of_a_rim_comes_over_the_smooth_faces_of_a_bent_pad() -> None:
    for result in compared("rim bent 45", samples=200):
        assert abs(result.ratio - 1) < 3.5 * result.error
        assert result.error < 0.06
        assert np.sqrt((result.z**2).mean()) < 1.6


@pytest.mark.parametrize(
    ("case", "most"), [("thin rim", 0.015), ("thin rim between mirrors", 0.06)]
)
def test_light_of_a_rim_comes_over_its_upper_face_and_to_and_fro_between_walls(
    case: str, most: float
) -> None:
    """What goes to and fro between mirrors of metal is found by chance, and bars say so."""
    for result in compared(case, samples=6000):
        assert abs(result.ratio - 1) < 3.5 * result.error
        assert result.error < most
        assert np.sqrt((result.z**2).mean()) < 1.45


def main() -> None:
    """Compare the cases that are named, or all of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(WHOLE))
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--photons", type=int)
    chosen = parser.parse_args()
    for case in chosen.cases or WHOLE:
        try:
            compared(case, chosen.samples, chosen.photons)
        except RenderError as error:
            print(f"{case:28s} {error}", flush=True)


if __name__ == "__main__":
    main()
