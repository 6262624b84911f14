"""LEDs that lamps may be: data sheets in numbers, and the light that a camera sees of them."""

from render.scene.catalog.led import (
    Die,
    Led,
    LedEntry,
    entries_in,
    entries_of,
    known_entries,
    known_leds,
    naming_problems,
    own_problems,
    responses,
    shipped_leds,
)
