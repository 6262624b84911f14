"""Fitting the scene's material, powers and gains to photographs of the rig (thesis 3.3.2)."""
