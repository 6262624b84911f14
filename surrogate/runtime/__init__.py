"""Running a shipped model: numpy and onnxruntime only."""
