"""Photographs: taken, read, checked, dewarped."""
