"""Traced light is kept piece by piece: what is ended after every piece ends, and bit-equal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import render.preview.converged.transport
from render.arrays import Array
from render.finished_parts import FinishedParts
from render.preview.converged import Effort, converged_transport, transport_at
from render.preview.diffuser.cache import cache_folder
from render.progress import Clock, Progress
from render.scene import Scene
from tests.optimize.overnight.tiny import tiny_scene
from tests.oracles.pads import scene_of_case

PHI = np.array([0.5, 1.2])


class Ended(Exception):
    """What ends the work."""


class EndingParts(FinishedParts):
    """Ends the work after every piece that is kept."""

    def save(self, name: str, arrays: Mapping[str, Array]) -> None:
        super().save(name, arrays)
        raise Ended


@pytest.fixture(params=["diffuser", "clear"])
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Scene:
    return tiny_scene(tmp_path) if request.param == "diffuser" else scene_of_case("smooth")


def test_work_that_is_ended_after_every_piece_ends_bit_equal(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render.preview.converged.transport, "SAVE_SECONDS", 0.0)
    effort = Effort(photons=2000, paths=64, arrivals=600_000, rounds=2)

    def found(parts: FinishedParts) -> tuple[Array, ...]:
        return transport_at(scene, 0.0, PHI, effort, Clock(1, None), parts=parts)

    attempts = 1
    while True:
        try:
            ended = found(EndingParts(tmp_path / "parts", "key"))
            break
        except Ended:
            attempts += 1
    files = [*(tmp_path / "parts").rglob("*.npz")]
    # A piece of several threads at once may be kept by each of them.
    assert len(files) <= 2 * attempts
    assert attempts > 5
    for whole, part in zip(found(FinishedParts(None, "")), ended, strict=True):
        assert whole.tobytes() == part.tobytes()


def test_parts_of_other_work_are_not_taken(scene: Scene, tmp_path: Path) -> None:
    effort = Effort(photons=1000, paths=32, arrivals=200_000, rounds=1)
    folder = tmp_path / "parts"

    def cells(seed: int, key: str) -> bytes:
        parts = FinishedParts(folder, key)
        found = transport_at(scene, 0.0, PHI, effort, Clock(1, None), seed, parts)
        return found.cells.tobytes()

    assert cells(0, "first") != cells(1, "second")
    assert cells(1, "second") == cells(1, "second")


def test_the_cache_keeps_parts_until_the_whole_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    effort = Effort(photons=2000, paths=64, arrivals=600_000, rounds=1)
    scene, told = tiny_scene(tmp_path), list[Progress]()

    def end(at: Progress) -> None:
        told.append(at)
        if at.done > 0.5 * at.total:
            raise Ended

    with pytest.raises(Ended):
        converged_transport(scene, end, effort=effort)
    assert [*cache_folder().glob("converged-*.parts/*.npz")]
    first = len(told)
    again = list[Progress]()
    converged_transport(scene, again.append, effort=effort)
    assert first
    assert again[0].done > 0
    assert not [*cache_folder().glob("converged-*.parts")]
    assert len([*cache_folder().glob("converged-*.npz")]) == len(scene.state_axis)
