"""Rendering a tactile sensor: preview and reference; knows no other package."""


def register_plugins() -> None:
    """Make the plugins of this package known to Mitsuba's current variant."""
    from render.integrators import register

    register()
