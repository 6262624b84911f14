"""From a design to a thing: how fibers are mounted, what it costs, and the jig that holds them."""

from optimize.mounting.feeds import FULL_MILLIAMPERES, Feeds
from optimize.mounting.jig import JigError, Mesh, drilling_jig, stl_bytes
from optimize.mounting.mounting import (
    ANGLE_STEP,
    MountedFiber,
    Mounting,
    mount,
    wiring_csv,
)
from optimize.mounting.mounting_errors import ErrorCost, mounting_error_costs, surrogate_score
