"""Vertices of light and camera subpaths, and how they are found and connected."""
