"""What light meets, for Mitsuba: the pad and the lit sensor as scenes, and the fibers' profile."""
