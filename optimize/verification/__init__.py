"""Designs at level 2: verification, the loop in which renders decide, the thesis procedure."""
