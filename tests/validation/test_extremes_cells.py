"""Sensors at the ends of the scene file's ranges, through the transport cells.

Demanded: finite cells with an error bar, or a typed error that names what to change.
"""

from __future__ import annotations

import re
import time
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from render.errors import RenderError, SceneError
from render.geometry import counted_sites
from render.reference import TransportEstimate, render_transport
from render.scene import Scene, load_scene, unchecked
from tests.validation.film import LONG

PHI = np.array([0.0, np.pi / 2, np.pi])
SAMPLES = 50 if LONG else 4
# One column of sites and a fiber per edge keep the cells few.
FEW: dict[str, Any] = {
    "fibers.left": 1, "fibers.tip": 1, "fibers.right": 1, "sites.columns": 1, "sites.rows": 3,
}  # fmt: skip


def edited(folder: Path, **values: Any) -> Scene:
    """Return ``finger20`` with values like ``"pad.index": 1.0`` written into its file."""
    lines = (resources.files("render") / "scenes" / "finger20.toml").read_text().splitlines()
    left = FEW | values
    section = ""
    for i, line in enumerate(lines):
        if line.startswith("["):
            section = line.strip("[]")
        key = f"{section}.{line.split(' = ')[0]}"
        if key in left:
            value = left.pop(key)
            lines[i] = (
                re.sub(r"value = [^,\]]+,", f"value = {value},", line)
                if "value" in line
                else f"{line.split(' = ')[0]} = {value}"
            )
    assert not left, f"finger20.toml has no {sorted(left)}"
    path = folder / "scene.toml"
    path.write_text("\n".join(lines))
    return load_scene(path)


def render(scene: Scene, bend: float = 0.0, **settings: Any) -> TransportEstimate:
    chosen = {"samples": SAMPLES, "replicates": 8} | settings
    return render_transport(scene, PHI, np.radians([bend]), **chosen)


ENDS: list[dict[str, Any]] = [
    {"diffuser.sigma_s": 0.0}, {"diffuser.sigma_s": 0.0, "diffuser.sigma_a": 0.0},
    {"diffuser.sigma_s": 0.01}, {"diffuser.sigma_s": 50.0}, {"diffuser.g": -0.9},
    {"diffuser.g": 0.0}, {"diffuser.g": 0.99}, {"diffuser.sigma_a": 0.0},
    {"diffuser.sigma_a": 10.0}, {"pad.roughness": 0.0}, {"pad.roughness": 0.5},
    {"pad.index": 1.0}, {"pad.index": 1.7}, {"fibers.sigma_v": 0.1}, {"fibers.sigma_v": 89.0},
    {"diffuser.sigma_s": 50.0, "diffuser.sigma_a": 0.0, "diffuser.g": 0.0, "pad.index": 1.7},
    {"diffuser.sigma_s": 0.0, "fibers.sigma_v": 0.1, "pad.roughness": 0.0},
]  # fmt: skip
FAST = [3, 11, 13]


@pytest.mark.parametrize(
    "end",
    ENDS if LONG else [ENDS[i] for i in FAST],
    ids=lambda end: ", ".join(f"{k} {v}" for k, v in end.items()),
)
def test_at_its_ends_a_value_gives_finite_cells_with_error_bars(
    tmp_path: Path, end: dict[str, Any]
) -> None:
    scene = edited(tmp_path, **end)
    began = time.process_time()
    estimate = render(scene)
    seen = np.isfinite(estimate.T)
    T, se = estimate.T[seen], estimate.se[seen]
    print(
        f"{end}: {time.process_time() - began:.1f} s; median cell {np.median(T):.3g}, error "
        f"{np.median(se) / T.mean():.0%} of the mean, exactly 0: {(T == 0).mean():.0%}"
    )
    assert seen.all()
    assert np.isfinite(se).all()
    assert (T >= 0).all()
    assert (se > 0).all()
    assert np.isfinite(estimate.background).all()


def test_a_cell_that_no_path_has_lit_yet_does_not_claim_to_be_dark(tmp_path: Path) -> None:
    scene = edited(tmp_path, **{"pad.index": 1.0})
    truth = render(scene, samples=1024)
    assert (truth.T > 0).all()
    covered = []
    for seed in range(3):
        estimate = render(scene, samples=4, seeds=(seed,))
        assert (estimate.se > 0).all()
        covered += list((2 * estimate.se >= truth.T)[estimate.T == 0])
    print(f"{len(covered)} unlit cells of {3 * truth.T.size}: covered {np.mean(covered):.1%}")
    assert len(covered) > 50
    assert np.mean(covered) >= 0.95


def test_a_smooth_pad_is_the_limit_of_rough_ones(tmp_path: Path) -> None:
    levels = []
    for roughness in (0.0, 0.03):
        replicates = render(
            edited(tmp_path, **{"pad.roughness": roughness}), samples=400, replicates=16
        ).replicates
        level = replicates.mean(axis=(1, 2, 3, 4, 5))
        levels.append((level.mean(), stats.sem(level)))
        print(f"roughness {roughness}: {levels[-1][0]:.3e} +- {levels[-1][1]:.1e}")
    (smooth, smooth_bar), (rough, rough_bar) = levels
    assert np.hypot(smooth_bar, rough_bar) < 0.1 * rough
    # Their light differs by a few percent in truth.
    assert abs(smooth - rough) < 3 * np.hypot(smooth_bar, rough_bar) + 0.05 * rough


@pytest.mark.parametrize("bend", [0.0, 180.0])
def test_a_pad_at_either_end_of_its_bends_has_finite_cells(tmp_path: Path, bend: float) -> None:
    scene = load_scene("finger20")
    scene = unchecked(
        edited(tmp_path), {"bending": unchecked(scene.bending, {"angles": (np.radians(bend),)})}
    )
    estimate = render(scene, bend)
    assert np.isfinite(estimate.T).all()
    assert np.isfinite(estimate.se).all()
    assert (estimate.T >= 0).all()


def test_a_fiber_that_points_along_its_edge_is_dim_but_finite(tmp_path: Path) -> None:
    # phi 0 and pi: at the ends of the range, without a scattering layer and with a thin beam.
    scene = edited(tmp_path, **{"fibers.sigma_v": 5.0})
    estimate = render(scene)
    by_phi = estimate.T.mean(axis=(0, 2, 3, 4))
    print(f"phi 0, pi/2, pi: {by_phi}")
    assert np.isfinite(by_phi).all()
    assert by_phi[1] > by_phi[0]
    assert by_phi[1] > by_phi[2]


def test_a_site_that_the_camera_cannot_see_has_no_cells_and_the_others_do(tmp_path: Path) -> None:
    scene = edited(tmp_path, **{"camera.field_of_view": 30.0, "sites.spacing": 6.0})
    estimate = render(scene)
    assert estimate.T.shape[3] == len(counted_sites(scene)) == 1
    assert np.isfinite(estimate.T).all()
    assert (estimate.T.sum(axis=(0, 1)) > 0).all()


def test_a_camera_that_sees_no_site_is_told_what_to_change(tmp_path: Path) -> None:
    scene = edited(tmp_path, **{"camera.y": 500.0, "camera.field_of_view": 30.0})
    with pytest.raises(SceneError, match="move the camera") as caught:
        render(scene)
    assert caught.value.field == "camera"


def test_a_black_coating_is_named_as_a_reason_for_darkness(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"coating\.albedo"):
        render(edited(tmp_path, **{"coating.albedo": 0.0}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("diffuser.sigma_s", 50.1), ("diffuser.sigma_s", -1), ("diffuser.g", 1.0),
        ("diffuser.sigma_a", 11), ("pad.roughness", 0.6), ("pad.index", 0.9),
        ("fibers.sigma_v", 0.0), ("fibers.sigma_v", 90), ("diffuser.g", "nan"),
        ("pad.index", "inf"),
    ],
)  # fmt: skip
def test_beyond_its_ends_a_value_is_refused_by_name(tmp_path: Path, key: str, value: Any) -> None:
    with pytest.raises(SceneError, match=re.escape(f"{key} = ")) as caught:
        edited(tmp_path, **{key: value})
    assert "allowed" in str(caught.value) or "finite" in str(caught.value)


@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_the_bound_on_events_costs_a_known_share_of_the_light_at_the_thickest_layer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.cells import facet_paths, light_subpaths
    from render.sampling import proposals

    scene = edited(tmp_path, **{"diffuser.sigma_s": 50.0})
    levels, bars = [], []
    for bound in (light_subpaths.RESERVOIR_EVENT, 4 * light_subpaths.RESERVOIR_EVENT):
        monkeypatch.setattr(light_subpaths, "RESERVOIR_EVENT", bound)
        for module in (light_subpaths, facet_paths, proposals):
            monkeypatch.setattr(module, "LIGHT_EVENTS", 2 * bound)
        began = time.process_time()
        replicates = render(scene, samples=1600, replicates=32).background_replicates
        level = replicates.mean(axis=(1, 2, 3, 4))
        levels.append(level.mean())
        bars.append(stats.sem(level) / level.mean())
        print(
            f"light subpaths of at most {bound} events: background {levels[-1]:.3e} "
            f"+- {bars[-1]:.1%}, {time.process_time() - began:.1f} s"
        )
    ratio = levels[0] / levels[1]
    # With 2048 events it was 0.80 +- 0.02.
    assert abs(ratio - 1.0) < 3 * np.hypot(*bars)
