"""Running a shipped model: numpy and onnxruntime only."""

from surrogate.runtime.checker import Checker, family_hash
from surrogate.runtime.metadata import ModelMetadata
from surrogate.runtime.model_file import MODEL_FILE, rendering_seconds, sha256
from surrogate.runtime.ranking import RankingTest
