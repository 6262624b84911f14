"""What a design is worth in degrees of surface normal, by what people read with."""

from optimize.readers.camera_model import CameraModel
from optimize.readers.compare_readings import (
    JSON_NAMES,
    ErrorComparison,
    compare_readings,
    reads_better,
)
from optimize.readers.expected_error import ExpectedError
from optimize.readers.model_colors import ModelColors, likely_errors
from optimize.readers.named_readers import expected_error
from optimize.readers.normals import guessing_error
from optimize.readers.place_error import PlaceError
from optimize.readers.press_reading import (
    FRAMES,
    HEIGHTS,
    DepthReading,
    ExposedDesign,
    check_flat,
    read_press,
)
from optimize.readers.reader_merit import ReaderMerit, merit_of
from optimize.readers.reading import (
    SEEDS,
    ExposedColors,
    ReaderFigures,
    Reading,
    half_width,
    reading,
)
from optimize.readers.rendered_degrees import RenderedDegrees, rendered_degrees
from optimize.readers.saturation import saturating_tilts
from optimize.readers.sensor_error import SensorError
