"""Mitsuba's own path tracer, as the frontier uses it."""

from __future__ import annotations

import numpy as np
import pytest

from render.reference import path_tracer
from render.reference.path_tracer import PathTracer
from render.scene import load_scene


@pytest.mark.usefixtures("variant_kept")
def test_samples_in_passes_are_other_samples_of_the_same_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As many at once as fit into memory; few paths carry most light, so it is clipped."""
    scene = load_scene("finger20")
    tracer, lamps = PathTracer(scene), scene.lamp_count
    design = np.full(lamps, np.pi / 2), np.ones((lamps, len(scene.palette.channels)))
    whole = tracer.radiance(*design, spp=6, seed=0)
    monkeypatch.setattr(path_tracer, "MAX_PATHS", 60_000)
    parts = tracer.radiance(*design, spp=6, seed=0)
    assert parts.shape == whole.shape
    assert not np.array_equal(parts, whole)
    assert np.count_nonzero(parts) == pytest.approx(np.count_nonzero(whole), rel=0.15)
    assert np.minimum(parts, 1e-4).mean() == pytest.approx(np.minimum(whole, 1e-4).mean(), rel=0.15)
