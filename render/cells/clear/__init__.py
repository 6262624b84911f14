"""Flat clear pads of smooth or painted faces, rendered for all lamps at once."""
