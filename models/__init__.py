"""The models that come with tactilux: one folder per scene, found by the scene's hash."""
