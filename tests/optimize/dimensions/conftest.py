"""A small sensor, and studies of it that several tests look at."""

from __future__ import annotations

import pytest

from optimize.dimensions import Study, Variants, dimension_of, run_study
from render.scene import Scene, load_scene, rewritten


@pytest.fixture(scope="session")
def small() -> Scene:
    """Return the DIGIT with four sites of six facets, which the preview draws in seconds."""
    scene = load_scene("digit").with_(sites={"columns": 2, "rows": 2}, indenter={"faces": 6})
    return rewritten(scene, "a small DIGIT")


@pytest.fixture(scope="session")
def distances(small: Scene) -> Study:
    """Return a study of the camera's distance, which moves its view of the facets a little."""
    variants = Variants(small, [dimension_of(small, "camera.distance=14.9,15.1")])
    return run_study(variants, coarse=True)
