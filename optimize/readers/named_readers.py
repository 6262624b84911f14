"""The closed forms of the readers by their names."""

from __future__ import annotations

from optimize.objectives import ReaderName
from optimize.readers.camera_model import CameraModel
from optimize.readers.expected_error import ExpectedError
from optimize.readers.place_error import PlaceError
from optimize.readers.sensor_error import SensorError
from render.scene import Scene


def expected_error(name: ReaderName, scene: Scene, camera: CameraModel) -> ExpectedError:
    """Return the closed form of what the reader of that ``name`` misses on ``scene``."""
    kinds: dict[ReaderName, type[ExpectedError]] = {"sensor": SensorError, "place": PlaceError}
    return kinds[name](scene, camera)
