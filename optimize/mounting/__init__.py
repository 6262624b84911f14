"""From a design to a thing: how fibers are mounted, what it costs, and the jig that holds them."""

from optimize.mounting.banding import banding_sentences, pulse_ripple
from optimize.mounting.jig import JigError, Mesh, drilling_jig, stl_bytes
from optimize.mounting.mounting import (
    ANGLE_STEP,
    FULL_LEVEL,
    ErrorCost,
    Feeds,
    MountedFiber,
    Mounting,
    empty_places,
    leds_per_fiber,
    mount,
    mounting_error_costs,
    surrogate_score,
    wiring_csv,
)
