"""What identifies the physical content of a scene, however its file says it."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

from render.scene.camera import READ_BY_CAMERA, TIMES
from render.scene.colors import DEFAULT_CHANNELS, RGB
from render.scene.faces import Finish
from render.scene.lamps import FACES, RIM_EDGES

if TYPE_CHECKING:
    from render.scene.schema.scene import Scene


def content_hash(scene: Scene) -> str:
    """Return 16 hex digits of what changes light: the beginning of a SHA-256 of sorted JSON."""
    lightless = {"name", "constraints", "search", "parts", "tolerances", "free"}
    content = scene.model_dump(mode="json", exclude=lightless, exclude_none=True)
    content |= {"schema_version": 1, "diffuser": content.get("diffuser")}
    if scene.diffuser is not None:
        content["diffuser"].pop("on", None)
        if scene.diffuser_edges != RIM_EDGES:
            content["diffuser"]["on"] = scene.diffuser_edges
    if scene.coating.lobe is None:
        for key in ("specular", "roughness"):
            content["coating"].pop(key, None)
    for color in content.get("colors", ()):
        color.pop("ink", None)
    for key in ("body_height", "unit"):
        content.get("skin", {}).get("mesh", {}).pop(key, None)
    for state in content.get("states", ()):
        state.pop("name")
    # However the file groups them, and only those that are not like the rest of the pad.
    plain = Finish(scene.pad.roughness)
    content["faces"] = {
        face: finish.content
        for face, finish in zip(FACES, scene.finishes, strict=True)
        if finish != plain
    }
    if not content["faces"]:
        del content["faces"]
    one_shot = scene.palette.one_shot
    if one_shot == RGB:
        content.pop("colors", None)
    if scene.palette.shots == 1:
        content["camera"].pop("shots", None)
    if one_shot.channels == DEFAULT_CHANNELS:
        content["camera"].pop("channels", None)
    for key in (*READ_BY_CAMERA, *TIMES):
        content["camera"].pop(key, None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
