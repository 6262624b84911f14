"""Level 1 of the fidelity ladder: the preview corrected by a learned residual, as ONNX."""
