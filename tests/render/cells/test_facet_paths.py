"""Camera subpaths of cells: which vertices they pass, and which they keep for connections."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np

from render.cells.cell_sampler import PictureSampler
from render.sampling.streams import HashedStream
from tests.oracles.pads import scene_of_case

COUNT = 1 << 14


def test_a_vertex_that_is_passed_in_a_volume_is_kept_once(mono: ModuleType) -> None:
    """As the end of a subpath, and not among its glossy vertices as well."""
    scene = scene_of_case("rim bent 45")
    phi, power = np.zeros(scene.lamp_count), np.eye(scene.lamp_count)[0][:, None]
    sampler = PictureSampler(scene, phi, power, scene.bending.angles[0], True, 64, 64)
    rng = np.random.default_rng(4)
    column, row = (mono.Float((64 * rng.random(COUNT)).astype(np.float32)) for _ in range(2))
    stream = HashedStream(dr.arange(mono.UInt32, COUNT))
    first, lamp = mono.UInt32(1), dr.zeros(mono.UInt32, COUNT)
    found = sampler.camera_subpath(column, row, (64, 64), stream, first, lamp)
    end, glossy = found.end.vertex, found.glossy.vertex
    passed = np.array(end.volume & (end.weight > 0) & (found.end.passes > 0))
    assert passed.mean() > 0.01
    assert not np.array(glossy.volume & (glossy.weight > 0)).any()
