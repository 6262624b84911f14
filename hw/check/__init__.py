"""The start-up check: does the untouched pad look as designed? numpy and onnxruntime only.

One fiber at a time (``sweep_check``) or all at once (``image_check``), against what the model says
(``prediction``) or how the healthy rig looked (``commission``).
"""
