"""Every figure on docs/figures.md is made by its command, here with less effort."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.examples.test_figures import made


def test_renderers_compared(tmp_path: Path) -> None:
    rows = made("3.2", tmp_path, "--spp", 2, "--seconds", 2)
    # At equal samples: how many samples equal time holds is the machine's affair.
    error = {row["integrator"]: row["error"] for row in rows if row["at"] == "equal samples"}
    assert error["bdpt"] < 0.5 * error["volpath"]


def test_the_luminance_scale(tmp_path: Path) -> None:
    rows = made("3.3", tmp_path, "--most", 100_000)
    first, second = (row["relative_std"] for row in rows)
    assert second < first


def test_one_fiber_of_the_emulated_rig(tmp_path: Path) -> None:
    bends = made("3.5", tmp_path, "--rig-samples", 50)
    errors = [line["relative_rms"] for lines in bends.values() for line in lines.values()]
    assert set(bends) == {"bend 0", "bend 90"}
    assert np.median(errors) < 0.15


def test_all_fibers_of_the_emulated_rig(tmp_path: Path) -> None:
    numbers = made("3.6", tmp_path, "--rig-samples", 50)
    assert min(numbers["correlation"]) > 0.9


def test_contacts_and_a_bolt(tmp_path: Path) -> None:
    assert len(made("5.2", tmp_path)["sites_mm"]) == 15
    contrast = made("5.3", tmp_path)["edge_contrast"]
    assert sum(contrast["optimized"]) > sum(contrast["baseline"])
