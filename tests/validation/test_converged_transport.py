"""Preview and model of finger20 against compiled walks that share next to nothing with either.

The walks (``render.preview.converged``) against closed forms, another walk and themselves; then
colors of random designs, converged and from the shader, against those of the trained model, which
renders of level 2 made. From the command line, with full effort:
``python -m tests.validation.test_converged_transport``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import kendalltau

from optimize.scoring import open_model
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.preview import Preview
from render.preview.converged.transport import Effort, task_count, transport_at
from render.progress import Clock
from render.scene import load_scene
from surrogate.preview_model import preview_checker
from surrogate.training.evaluation import random_colors
from tests.long import LONG

SCENE = load_scene("finger20")
DESIGNS = 40
QUICK = Effort(photons=60_000, paths=8_192)


@dataclass(frozen=True)
class Deviation:
    """Of colors of facets from the model's: rms over rms, and the ratio of the sums."""

    rms: float
    ratio: float


def deviations(bend: float, effort: Effort) -> tuple[Deviation, Deviation]:
    """Return those of converged transport and of the shader's, over random designs."""
    rng = np.random.default_rng(0)
    phi = rng.uniform(0.0, np.pi, (DESIGNS, SCENE.lamp_count))
    power = np.eye(3)[rng.integers(0, 3, phi.shape)]
    model = open_model(SCENE)
    assert model.level == "surrogate"
    known = model.run(phi, power, np.array([bend]))["counts"][:, 0]
    below = (known.max(axis=-1) < 250.0)[..., None]  # the others saturate

    def deviation(nodes: np.ndarray, cells: np.ndarray) -> Deviation:
        light = np.einsum("dfj,fjsk->dfsk", interpolation_weights(nodes, phi), cells)
        colors = model.exposure * np.einsum("dfsk,dfc->dskc", light, power)
        apart = (colors - known) * below
        return Deviation(
            float(np.sqrt((apart**2).sum() / ((known * below) ** 2).sum())),
            float((colors * below).sum() / (known * below).sum()),
        )

    few, many = (chebyshev_nodes(count, 0.0, np.pi) for count in (13, 33))
    cells = transport_at(SCENE, bend, few, effort, Clock(task_count(SCENE, effort), None)).cells
    with Preview(SCENE) as preview:
        shader, _ = preview.transport(many, np.array([bend]))
    return deviation(few, cells[..., :-1]), deviation(many, shader[:, :, 0])


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0] if LONG else [90.0])
def test_renders_agree_with_converged_transport_better_than_with_the_shader(degrees: float) -> None:
    converged, shader = deviations(np.radians(degrees), Effort() if LONG else QUICK)
    assert converged.rms < (0.018 if LONG else 0.03)
    assert converged.ratio == pytest.approx(1.0, abs=0.015)
    assert converged.rms < shader.rms


def designs_told() -> None:
    """Print how far both previews are from the model, over 200 random designs at all bends."""
    rng, bends = np.random.default_rng(1), np.array(SCENE.bending.angles)
    phi = rng.uniform(0.0, np.pi, (200, SCENE.lamp_count))
    power, model = np.eye(3)[random_colors(*phi.shape, rng)], open_model(SCENE)
    known = model.run(phi, power, bends)
    for coarse in (True, False):
        said = preview_checker(SCENE, coarse=coarse).run(phi, power, bends)
        off = np.linalg.norm(said["counts"] - known["counts"], axis=-1)
        off /= np.linalg.norm(known["counts"], axis=-1)
        score = np.abs(said["score"] - known["score"])
        tau = kendalltau(said["score"], known["score"]).statistic
        level = "as drawn" if coarse else "converged"
        print(
            f"{level}: colors off by {np.median(off):.2%} (median), "
            f"{np.quantile(off, 0.95):.2%} (95 %), scores by {np.median(score):.2f}, "
            f"{np.quantile(score, 0.9):.2f} (90 %), tau {tau:.3f}"
        )


if __name__ == "__main__":
    designs_told()
    for angle in SCENE.bending.angles:
        for name, found in zip(("converged", "shader"), deviations(angle, Effort()), strict=True):
            print(f"{np.degrees(angle):3.0f} deg, {name}: {found.rms:.2%} rms, {found.ratio:.4f}")
