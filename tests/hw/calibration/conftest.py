"""The default sensor, and the toy's table of materials."""

from __future__ import annotations

import pytest

from hw.calibration.material_table import MaterialTable
from render.scene import Scene, load_scene
from tests.hw.calibration.toy import toy_table


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Return the default sensor."""
    return load_scene("finger20")


@pytest.fixture(scope="session")
def table(scene: Scene) -> MaterialTable:
    """Return the toy's table."""
    return toy_table(scene)
