"""What few renders teach a model: never less than converged light knew without them.

``finger20`` is trained with few samples a cell; its colors and scores are held against the shipped
model, which 12,000 samples a cell taught. From the command line, for other efforts:
``python -m tests.validation.test_few_renders --samples 150``.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from render.scene import load_scene
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from surrogate.train import TrainConfig, train
from surrogate.training.evaluation import random_colors
from surrogate.training.fit_task import FitConfig
from surrogate.training.mlp import NetworkConfig

SHIPPED = Path(__file__).parents[2] / "models" / "finger20"
SAMPLES = 12
"""A cell is then known to some 60 %."""
DESIGNS = 100
SLACK = 1.1
"""A correction that is not there may still be chosen, once in twenty."""


@dataclass(frozen=True)
class Errors:
    """Of colors, relative (median, 95 %), of scores in counts (median), and the rankings' tau."""

    color: float
    color_p95: float
    score: float
    tau: float


def errors(checker: Checker, truth: Checker) -> Errors:
    """Return the errors of random designs at the scene's own bends."""
    rng, lamps = np.random.default_rng(3), truth.metadata.fibers
    phi = rng.uniform(0.0, np.pi, (DESIGNS, lamps))
    power = np.eye(3)[random_colors(DESIGNS, lamps, rng)]
    bends = np.array(truth.metadata.scene_bends)
    found, known = (model.run(phi, power, bends) for model in (checker, truth))
    off = np.linalg.norm(found["counts"] - known["counts"], axis=-1)
    off /= np.linalg.norm(known["counts"], axis=-1)
    return Errors(
        color=float(np.median(off)),
        color_p95=float(np.quantile(off, 0.95)),
        score=float(np.median(np.abs(found["score"] - known["score"]))),
        tau=float(kendalltau(found["score"], known["score"]).statistic),
    )


def trained(folder: Path, samples: int, network: NetworkConfig) -> Checker:
    """Return the model of ``finger20`` from so many samples a cell."""
    config = TrainConfig(samples=samples, fit=FitConfig(network=network))
    made = train(load_scene("finger20"), folder / "model", config=config)
    print(f"residual: {made.fit.kind}, on the {made.metadata.preview_name}", flush=True)
    return Checker.load(made.folder)


def test_a_model_of_few_renders_is_no_worse_than_the_preview_that_it_corrects(
    tmp_path: Path,
) -> None:
    truth = Checker.load(SHIPPED)
    before = errors(preview_checker(load_scene("finger20")), truth)
    after = errors(trained(tmp_path, SAMPLES, NetworkConfig(steps=1000)), truth)
    assert before.color < 0.012
    assert after.color < SLACK * before.color
    assert after.score < SLACK * before.score + 0.1
    assert after.tau > 0.95


def main() -> None:
    """Print the errors of both previews and of a model."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=150)
    asked = parser.parse_args()
    truth, scene = Checker.load(SHIPPED), load_scene("finger20")
    print("preview as drawn", errors(preview_checker(scene, coarse=True), truth), flush=True)
    print("surrogate (converged)", errors(preview_checker(scene), truth), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        made = trained(Path(folder), asked.samples, NetworkConfig())
    print(f"{asked.samples} samples a cell", errors(made, truth))


if __name__ == "__main__":
    main()
