"""From a design to a thing: how lamps are mounted, what it costs, their jig and their board."""

from optimize.mounting.banding import banding_sentences
from optimize.mounting.board import board_dxf, board_svg
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
from optimize.mounting.pulses import pulse_rates, pulse_ripple, pulsed_light, whole_periods
