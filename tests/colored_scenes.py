"""Scene files with LEDs of other colors than the default ones, for tests."""

from __future__ import annotations

import json
from pathlib import Path

from render.scene import RGB, Scene, load_scene, scene_text

COLOR = '[[colors]]\nname = "{}"\nresponse = {{ value = {}, source = "test" }}\n'
WHITE = COLOR.format("white", "[1.0, 1.0, 0.8]")
AMBER = COLOR.format("amber", "[1.0, 0.4, 0.0]")
GREEN = COLOR.format("green", "[0.0, 1.0, 0.0]")
SAID = "".join(
    COLOR.format(name, str([float(name == other) for other in RGB.names])) for name in RGB.names
)
BASELINE = 'left = "{}"\ntip = "{}"\nright = "{}"'
OLD = scene_text("finger20")
SMALLER = (
    ("left = 8\ntip = 4\nright = 8", "left = 3\ntip = 2\nright = 3"),
    ("columns = 3\nrows = 5", "columns = 1\nrows = 2"),
    ("[0.0, 45.0, 90.0]", "[0.0, 60.0]"),
)


def scene_with(
    folder: Path,
    more: str,
    baseline: tuple[str, str, str] = ("red", "blue", "green"),
    *,
    schema: int = 2,
    camera: str = "",
    small: bool = False,
) -> Scene:
    """Return finger20 with other LEDs; ``small`` has 8 fibers, 2 sites and 2 bends."""
    text = OLD.replace("schema = 1", f"schema = {schema}")
    for old, new in SMALLER if small else ():
        text = text.replace(old, new)
    start = text.index("[baseline]")
    end = text.find("\n[", start + 1)
    text = (
        text[:start] + "[baseline]\n" + BASELINE.format(*baseline) + "\n" + text[end:] * (end > 0)
    )
    text = text.replace("[camera]", f"[camera]\n{camera}")
    path = folder / "scene.toml"
    path.write_text(f"{text}\n{more}")
    return load_scene(path)


def mono(folder: Path, more: str = "", *, small: bool = False) -> Scene:
    """Return a scene that a mono camera sees, with white and infrared LEDs."""
    leds = COLOR.format("white", "[1.0]") + COLOR.format("infrared", "[0.4]")
    baseline, camera = ("white", "infrared", "white"), 'channels = ["gray"]'
    return scene_with(folder, leds + more, baseline, camera=camera, small=small)


def with_palette(
    folder: Path,
    sensor: str,
    leds: dict[str, list[float]],
    baseline: str,
    channels: tuple[str, ...] | None = None,
) -> Path:
    """Return the file, written to ``folder``, of a shipped ``sensor`` with other LEDs and channels.

    ``leds`` are the colors with the response of each, ``baseline`` the lines of that part.
    """
    text = scene_text(sensor)
    text = text[: text.index("[baseline]")] + f"[baseline]\n{baseline}\n\n"
    text += "\n".join(COLOR.format(name, response) for name, response in leds.items())
    if channels is not None:
        text = text.replace("[camera]", f"[camera]\nchannels = {json.dumps(channels)}")
    path = folder / "palette.toml"
    path.write_text(text)
    return path
