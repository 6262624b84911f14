"""Calibration: photographs of single fibers give the scene's material, powers and gains.

What is seen (``measurement``, along ``reference_lines``) is compared with what a material looks
like (``line_model``: drawn for many materials by ``material_table``) by least squares
(``residuals``, ``rig_fit``); renders (``pad_light``) correct and confirm it (``refine``).
"""
