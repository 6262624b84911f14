"""The shipped folder: ONNX file, model card, checksums, golden pair."""
