"""Rendering a tactile sensor: preview (level 0) and reference (level 2); knows no other package."""


def register_plugins() -> None:
    """Make the plugins of this package known to Mitsuba's current variant."""
    from render.integrators import register

    register()
