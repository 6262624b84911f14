"""A sensor of finger20's kind that is small enough to be drawn and traced in a moment."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

from render.scene import Scene


def small_scene(**changes: dict[str, Any]) -> Scene:
    """Return finger20 with 8 fibers, 6 sites and 6 facets; ``changes`` replace keys of parts."""
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text()
    content = tomllib.loads(text)
    content["fibers"] |= {"left": 3, "tip": 2, "right": 3}
    content["sites"] |= {"columns": 3, "rows": 2}
    content["indenter"] |= {"faces": 6}
    for part, keys in changes.items():
        content[part] = content.get(part, {}) | keys
    return Scene.model_validate(content)
