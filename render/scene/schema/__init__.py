"""The scene of a file: its parts, whether they fit together, and the hash of what they are."""

from render.scene.schema.scene import SCENE_NAME, Scene, Written
