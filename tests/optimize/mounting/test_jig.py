"""The drilling jig is one closed body with a hole along every fiber."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from optimize.design import Design, baseline_design, limits_of
from optimize.design.runs import around_rim
from optimize.mounting import JigError, drilling_jig, stl_bytes
from optimize.placement import searched_scene
from render.geometry import FiberHolder, flat_fiber_poses
from render.scene import Scene, load_scene, unchecked

FINGER20 = load_scene("finger20")


def printed(scene: Scene, design: Design) -> trimesh.Trimesh:
    """Return the jig as another program reads its file."""
    file = io.BytesIO(stl_bytes(drilling_jig(scene, design)))
    mesh = trimesh.load_mesh(file, file_type="stl")
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def with_fibers(**counts: int) -> Scene:
    return unchecked(FINGER20, {"fibers": unchecked(FINGER20.fibers, counts)})


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_every_allowed_design_has_a_closed_jig_with_a_hole_for_every_fiber(seed: int) -> None:
    phi = np.random.default_rng(seed).uniform(0.0, np.pi, 20)
    allowed = limits_of(FINGER20).nearest_directions(phi)
    mesh = printed(FINGER20, Design.of_colors(allowed, np.zeros(20, dtype=int)))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * 20


def test_its_volume_is_that_of_the_walls_less_the_holes() -> None:
    design = baseline_design(FINGER20)
    phi = design.phi + np.radians(np.resize([10.0, -15.0, 20.0], 20))
    mesh = printed(FINGER20, Design(phi, design.power))
    low, high = mesh.bounds
    x, y, wall = (
        9.0 + (FINGER20.box.rims[0] + FINGER20.fibers.gap),
        15.0 + (FINGER20.box.rims[1] + FINGER20.fibers.gap),
        3.0,
    )
    area = 2 * wall * (y + wall - low[1]) + 2 * x * wall
    corners = 48  # a polygon stands for the circle
    circle = 0.5 * corners * np.sin(2 * np.pi / corners) * (0.85 / 2) ** 2
    holes = (circle * wall / np.sin(phi) / np.cos(FINGER20.fibers.tilt)).sum()
    assert mesh.volume == pytest.approx(area * (high[2] - low[2]) - holes, rel=1e-5)
    assert (low[0], high[0], high[1]) == pytest.approx((-x - wall, x + wall, y + wall))


def test_the_rims_of_the_holes_lie_around_the_fibers() -> None:
    limits, rng = limits_of(FINGER20), np.random.default_rng(4)
    phi = limits.nearest_directions(rng.uniform(0.3, 2.8, 20))
    mesh = printed(FINGER20, Design(phi, np.tile([1.0, 0.0, 0.0], (20, 1))))
    poses = flat_fiber_poses(FINGER20)
    beams = poses.directions(phi)
    away = mesh.vertices[:, None] - poses.position
    apart = np.linalg.norm(away - (away * beams).sum(-1, keepdims=True) * beams, axis=-1)
    on_rim = np.abs(apart - 0.425) < 1e-4
    assert (on_rim.sum(axis=0) >= 2 * 48).all()  # of the inner and the outer face


def test_walls_stand_nearer_where_no_diffuser_lies() -> None:
    layer = FINGER20.diffuser
    assert layer is not None
    scene = unchecked(FINGER20, {"diffuser": unchecked(layer, {"on": ("left",)})})
    mesh, gap, wall = printed(scene, baseline_design(scene)), FINGER20.fibers.gap, 3.0
    low, high = mesh.bounds
    assert mesh.is_watertight
    assert (low[0], high[0], high[1]) == pytest.approx(
        (-9.0 - layer.thickness - gap - wall, 9.0 + gap + wall, 15.0 + gap + wall)
    )
    # The corner of the tip and the left wall is farther from the tip's first fiber than the other.
    holder = FiberHolder.of(scene)
    borders = zip(holder.first, holder.last, holder.corner, strict=True)
    at_tip = {(first, last): corner for first, last, corner in borders}
    assert at_tip[-1, 8] == pytest.approx(-9.0 - layer.thickness - gap)
    assert at_tip[11, -1] == pytest.approx(9.0 + gap)
    assert at_tip[7, -1] == pytest.approx(15.0 + gap)


def test_edges_without_fibers_are_plain_walls() -> None:
    scene = with_fibers(tip=0, right=0)
    mesh = printed(scene, baseline_design(scene))
    assert mesh.is_watertight
    assert mesh.euler_number == 2 - 2 * 8


def test_fibers_that_meet_have_no_jig() -> None:
    phi = np.full(20, np.pi / 2)
    phi[3], phi[4] = np.radians(150.0), np.radians(30.0)
    with pytest.raises(JigError, match="fibers 3 and 4 at 150 and 30 deg meet"):
        drilling_jig(FINGER20, Design(phi, np.tile([1.0, 0.0, 0.0], (20, 1))))
    assert list(FiberHolder.of(FINGER20).problems(phi))


def digit_design(lamps: int) -> tuple[Scene, Design]:
    """Return a DIGIT with places, and lamps lit evenly among those along all edges."""
    scene = searched_scene(load_scene("digit"), lamps=lamps)
    order = np.argsort(around_rim(scene))
    colors = np.full(scene.lamp_count, -1)
    picked = np.linspace(0, scene.lamp_count, lamps, endpoint=False).astype(int)
    colors[np.isin(order, picked)] = 0
    return scene, Design.of_colors(np.full(scene.lamp_count, np.pi / 2), colors)


@pytest.mark.parametrize("lamps", [3, 6, 9])
def test_chosen_places_on_all_edges_have_a_ring_of_walls_with_their_holes(lamps: int) -> None:
    scene, design = digit_design(lamps)
    mesh, poses = printed(scene, design), flat_fiber_poses(scene)
    lit = np.flatnonzero(design.colors >= 0)
    assert len(lit) == lamps
    assert {1, 3} & {*poses.face[lit].tolist()}
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    ring = 3 in poses.face[lit]
    assert mesh.euler_number == 2 - 2 * (lamps + ring)
    beams = poses.directions(design.phi)
    (width, length, height), wall = mesh.extents, FiberHolder.of(scene).thickness
    circle = 0.5 * 48 * np.sin(2 * np.pi / 48) * (poses.radius[lit] + 0.05) ** 2
    if ring:
        area = width * length - (width - 2 * wall) * (length - 2 * wall)
        assert mesh.volume == pytest.approx(area * height - circle.sum() * wall, rel=1e-5)
    away = mesh.vertices[:, None] - poses.position[lit]
    apart = np.linalg.norm(away - (away * beams[lit]).sum(-1, keepdims=True) * beams[lit], axis=-1)
    on_rim = np.abs(apart - poses.radius[lit] - 0.05) < 1e-4
    assert (on_rim.sum(axis=0) >= 2 * 48).all()


def test_lamps_that_no_wall_holds_have_no_jig() -> None:
    said = {"unit": "mm", "source": "test"}
    corners = [[-7.0, -9.0], [7.0, -9.0], [7.0, 9.0], [-7.0, 9.0]]
    board = {"corners": {"value": corners, **said}, "heights": {"value": [-3.0], **said}}
    asked = load_scene("digit").with_(schema=2, search={"places": [board]})
    scene = searched_scene(asked)
    colors = np.full(scene.lamp_count, -1)
    colors[[0, 5]] = 0
    design = Design.of_colors(np.full(scene.lamp_count, np.pi / 2), colors)
    with pytest.raises(JigError, match="lamp 5 sits below the pad, not beside an edge"):
        drilling_jig(scene, design)


def test_lamps_above_each_other_have_no_jig() -> None:
    heights = {"value": [1.0, 5.0], "unit": "mm", "source": "test"}
    rails = [{"edge": "left", "heights": heights}]
    scene = searched_scene(load_scene("digit").with_(schema=2, search={"places": rails}), lamps=2)
    places = np.array([lamp.position for lamp in scene.placed_lamps()])
    colors = np.full(scene.lamp_count, -1)
    colors[(places[:, 0] < -8.0) & (places[:, 1] == places[4, 1])] = 0
    assert (colors == 0).sum() == 2
    design = Design.of_colors(np.full(scene.lamp_count, np.pi / 2), colors)
    with pytest.raises(
        JigError, match=r"the hole of lamp \d+ meets another, or an end of the left"
    ):
        drilling_jig(scene, design)


def test_a_dark_design_has_no_jig() -> None:
    dark = Design(np.full(20, np.pi / 2), np.zeros((20, 3)))
    with pytest.raises(JigError, match="lights no lamp"):
        drilling_jig(FINGER20, dark)
