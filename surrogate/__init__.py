"""The surrogate: the preview corrected by traced light, and by a learned residual; as ONNX."""
