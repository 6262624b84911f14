"""A rig without hardware: an LED board behind a pseudo-terminal, and a camera that renders.

Imports ``calibration`` for its pictures of any material, never the other way round.
"""
