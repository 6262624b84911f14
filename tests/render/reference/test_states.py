"""States of a skin at level 2: the jobs, tables and pictures of the sensors that they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.errors import RenderError, SceneError
from render.geometry import ball
from render.reference import render_image, render_transport
from render.reference.job import RenderJob
from render.reference.transport import transport_jobs
from render.scene import Scene
from tests.oracles.soft_domes import CROWN, LOW, scene_text_of, write_files, written

AHEAD = np.array([np.pi / 2])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    return written(folder, scene_text_of("low", "twisted"))


@pytest.fixture(scope="module")
def sunk(folder: Path) -> Scene:
    return written(folder, scene_text_of(mesh="low.stl", crown=CROWN * LOW))


def test_jobs_are_those_of_plain_scenes_and_carry_all_that_they_need(
    scene: Scene, sunk: Scene
) -> None:
    jobs = transport_jobs(scene, AHEAD, np.array(scene.state_axis), samples=8, seeds=[1])
    (alone, untouched) = transport_jobs(sunk, AHEAD, np.zeros(1), samples=8, seeds=[1])
    assert [job.key for job in jobs[2:4]] == [alone.key, untouched.key]
    assert len({job.key for job in jobs}) == 6
    assert [job.name.split("-")[0] for job in jobs[::2]] == ["rest", "low", "twisted"]
    again = RenderJob.from_json(jobs[4].to_json())
    assert again.key == jobs[4].key


def test_states_that_are_none_raise_one_clear_error(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"state 3 of soft-dome, allowed"):
        transport_jobs(scene, AHEAD, np.array([3.0]), samples=8, seeds=[1])
    with pytest.raises(RenderError, match="what is pressed in stands on the skin of one"):
        render_image(scene, np.zeros(6), np.ones((6, 3)), 1.0, imprint=ball(scene))


@pytest.mark.slow
def test_every_state_is_rendered_as_the_plain_scene_of_its_mesh_bit_for_bit(
    scene: Scene, sunk: Scene
) -> None:
    states = np.array(scene.state_axis)
    table = render_transport(scene, AHEAD, states, samples=8)
    alone = render_transport(sunk, AHEAD, np.zeros(1), samples=8)
    assert table.T.shape == (6, 1, 3, 9, 6)
    for name in ("T", "background"):
        np.testing.assert_array_equal(getattr(table, name)[:, :, 1], getattr(alone, name)[:, :, 0])
    pictures = [
        render_image(
            sensor, np.full(6, np.pi / 2), np.ones((6, 3)), at, width=16, height=20, samples=2
        ).radiance
        for sensor, at in ((scene, 1.0), (sunk, 0.0))
    ]
    np.testing.assert_array_equal(*pictures)
