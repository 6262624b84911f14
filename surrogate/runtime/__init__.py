"""Running a shipped model: numpy and onnxruntime only."""

from surrogate.runtime.checker import Checker
from surrogate.runtime.metadata import ModelMetadata

__all__ = ["Checker", "ModelMetadata"]
