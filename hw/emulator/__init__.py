"""A rig without hardware: an LED board behind a pseudo-terminal, and a camera that renders."""
