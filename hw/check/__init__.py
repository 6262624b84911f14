"""The start-up check: does the untouched pad look as designed? numpy and onnxruntime only."""
