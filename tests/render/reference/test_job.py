"""Jobs of one pad: plain data that travels, and the result belongs to the job alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.reference import (
    RenderJob,
    render_transport,
    run_job,
    transport_estimate,
    transport_jobs,
)
from render.scene import Scene, load_scene, scene_content, scene_of, shipped_scenes, unchecked


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def jobs(scene: Scene) -> list[RenderJob]:
    phi = np.array([np.pi / 2, 1.0])
    return transport_jobs(scene, phi, np.array([0.0]), samples=4, seeds=(1,), replicates=4)


@pytest.mark.parametrize("name", shipped_scenes())
def test_a_scene_travels_as_text_without_losing_a_bit(name: str) -> None:
    scene = load_scene(name)
    arrived = scene_of(scene_content(scene))
    assert arrived.hash == scene.hash
    assert arrived.bending.angles == scene.bending.angles
    assert arrived.model_dump() == scene.model_dump() | dict.fromkeys(
        ("constraints", "tolerances", "free")
    )


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"scene": {}, "hash": "0"}'])
def test_a_scene_that_was_changed_on_the_way_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match="does not match its hash"):
        scene_of(text)


def test_an_altered_number_of_a_scene_is_noticed(scene: Scene) -> None:
    content = json.loads(scene_content(scene))
    content["scene"]["pad"]["width"] += 1e-12
    with pytest.raises(SceneError, match="does not match its hash"):
        scene_of(json.dumps(content))


def test_a_job_travels_as_text_and_keeps_its_key(jobs: list[RenderJob]) -> None:
    for job in jobs:
        arrived = RenderJob.from_json(job.to_json())
        assert arrived == job
        assert arrived.key == job.key


def test_everything_that_changes_the_result_changes_the_key(jobs: list[RenderJob]) -> None:
    job = jobs[0]
    scene = scene_of(job.scene)
    other = unchecked(scene, {"coating": unchecked(scene.coating, {"albedo": 0.5})})
    changed = [
        replace(job, scene=scene_content(other)),
        replace(job, phi=tuple((first, second + 1e-15) for first, second in job.phi)),
        replace(job, bend=0.1),
        replace(job, indented=not job.indented),
        replace(job, seed=2),
        replace(job, chains=2 * job.chains),
        replace(job, iterations=2 * job.iterations),
        replace(job, replicates=2),
        replace(job, sampler="pssmlt"),
    ]
    assert len({job.key, *(one.key for one in changed)}) == len(changed) + 1
    assert len({one.name for one in changed}) == len(changed)


def test_the_name_of_a_scene_has_no_part_in_the_key(scene: Scene, jobs: list[RenderJob]) -> None:
    renamed = unchecked(scene, {"name": "other"})
    assert replace(jobs[0], scene=scene_content(renamed)).key == jobs[0].key


def test_jobs_that_traveled_and_ran_backwards_gather_to_the_same_estimate(
    scene: Scene, jobs: list[RenderJob]
) -> None:
    results = [run_job(RenderJob.from_json(job.to_json())) for job in reversed(jobs)]
    found = transport_estimate(scene, jobs, results[::-1], 4)
    phi, bends = np.array([np.pi / 2, 1.0]), np.array([0.0])
    whole = render_transport(scene, phi, bends, samples=4, seeds=(1,), replicates=4)
    np.testing.assert_array_equal(found.replicates, whole.replicates)
    np.testing.assert_array_equal(found.background_replicates, whole.background_replicates)
    assert found.settings == whole.settings


def test_a_run_that_is_stopped_saves_its_state_first(jobs: list[RenderJob], tmp_path: Path) -> None:
    job, state = replace(jobs[0], iterations=3), tmp_path / "state.npz"

    def stop(count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(job, state, stop)
    ticks: list[int] = []
    resumed = run_job(job, state, ticks.append)
    assert ticks[0] == job.chains
    assert sum(ticks) == job.samples
    unbroken = run_job(job)
    np.testing.assert_array_equal(resumed.estimate, unbroken.estimate)
    np.testing.assert_array_equal(resumed.largest, unbroken.largest)
