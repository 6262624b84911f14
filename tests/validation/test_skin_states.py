"""States of a skin, previews and level 2, against photons among the triangles of the moved body.

From the command line:
``python -m tests.validation.test_skin_states [--samples N] [--photons N] [STATE ...]``.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from render.geometry import in_state
from render.preview import Preview
from render.preview.converged import Effort, transport_at
from render.preview.converged.transport import task_count
from render.progress import Clock
from render.reference import render_transport
from render.scene import Scene, load_scene
from tests.oracles.mesh_cells import BentScene
from tests.oracles.soft_domes import MOVES, scene_text_of, write_files

AHEAD = np.array([np.pi / 2])
PREVIEW_BOUND, CONVERGED_BOUND = 0.05, 0.02
"""Median over facets, and over sites, of how far the preview as drawn and converged may be off."""
EFFORT = Effort(paths=8192, arrivals=12_000_000)


def soft_dome() -> Scene:
    """Return the dome with all its states."""
    with tempfile.TemporaryDirectory(prefix="tactilux-dome-") as name:
        write_files(Path(name))
        (Path(name) / "scene.toml").write_text(scene_text_of(*MOVES))
        return load_scene(Path(name) / "scene.toml")


def compared(state: str, samples: int, photons: int) -> list[dict[str, float]]:
    """Return of facets and of sites what renders and previews differ from photons by.

    All six lamps together, each of ``photons``: ``ratio`` of sums with its error ``se``, ``rms_z``
    of single targets, ``off`` the drawn preview's median, ``converged_off`` and
    ``converged_ratio`` of the other one, and the ``noise`` of medians.
    """
    scene = soft_dome()
    number = np.array([float(scene.state_names.index(state))])
    table = render_transport(scene, AHEAD, number, samples=samples, replicates=16)
    with Preview(scene) as preview:
        drawn = preview.transport(AHEAD, number)
    clock = Clock(task_count(scene, EFFORT), None)
    followed = transport_at(scene, float(number[0]), AHEAD, EFFORT, clock).cells.sum(axis=(0, 1))
    moved, bend = in_state(scene, float(number[0]))
    found = []
    for name, replicates, light, paths in (
        ("facets", table.replicates, drawn[0], followed[:, :-1]),
        ("sites", table.background_replicates, drawn[1], followed[:, -1]),
    ):
        pad = BentScene(moved, bend, name == "facets", views=4000)
        batches = sum(
            pad.cells(lamp, AHEAD[0], photons).replicates for lamp in range(scene.lamp_count)
        )
        truth, noise = batches.mean(axis=0), stats.sem(batches, axis=0)
        renders = replicates.sum(axis=1).reshape(len(replicates), -1)
        mean, se = renders.mean(axis=0), stats.sem(renders, axis=0)
        sums = [part.sum(axis=1) for part in (renders, batches)]
        ratio = sums[0].mean() / sums[1].mean()
        error = np.hypot(*(stats.sem(part) / part.mean() for part in sums))
        off = np.abs(light.sum(axis=(0, 1, 2)).ravel() / truth - 1.0)
        found.append(
            {
                "ratio": float(ratio),
                "se": float(ratio * error),
                "rms_z": float(np.sqrt((((mean - truth) / np.hypot(se, noise)) ** 2).mean())),
                "off": float(np.median(off)),
                "converged_off": float(np.median(np.abs(paths.ravel() / truth - 1.0))),
                "converged_ratio": float(paths.sum() / truth.sum()),
                "noise": float(np.median(noise / truth)),
            }
        )
        print(
            f"{state} {name}: renders over photons {ratio:.4f} +- {ratio * error:.4f}, rms z "
            f"{found[-1]['rms_z']:.2f}; preview off by {found[-1]['off']:.1%} (median), "
            f"{np.percentile(off, 95):.1%} (95 %), converged {found[-1]['converged_off']:.1%} "
            f"(ratio of sums {found[-1]['converged_ratio']:.3f}), noise {found[-1]['noise']:.1%}",
            flush=True,
        )
    return found


@pytest.mark.parametrize("state", ["twisted"])
def test_a_state_has_the_light_that_photons_find_in_the_moved_body(state: str) -> None:
    for found in compared(state, samples=100, photons=300_000):
        assert abs(found["ratio"] - 1.0) < 4.0 * found["se"]
        assert found["rms_z"] < 1.6
        assert found["off"] < np.hypot(PREVIEW_BOUND, found["noise"])
        assert found["converged_off"] < np.hypot(CONVERGED_BOUND, found["noise"])
        assert abs(found["converged_ratio"] - 1.0) < 3.0 * found["se"] + 0.01


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("states", nargs="*", metavar="STATE")
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--photons", type=int, default=1_000_000)
    asked = parser.parse_args()
    for chosen in asked.states or ["rest", *MOVES]:
        compared(chosen, asked.samples, asked.photons)
