"""Searches over colors and directions."""
