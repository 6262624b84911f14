"""What is said of scores that noise hides."""

from __future__ import annotations

import numpy as np

from optimize.design import ScoreSettings
from optimize.scoring import noise_doubt
from tests.render.noisy_light import EXPOSURE, THREE, noisy_light

SETTINGS = ScoreSettings(EXPOSURE, lam=10.0)


def test_the_samples_asked_for_bring_the_score_below_the_doubt() -> None:
    rough = noisy_light(0.03, 0.03)
    said = noise_doubt(SETTINGS, rough, THREE, samples=1000)
    assert said.startswith("noise makes 7")
    assert "samples more per cell are needed" in said
    more = float(said.split("about ")[1].split(" samples")[0].replace(",", ""))
    enough = noisy_light(0.03, 0.03 * np.sqrt(1000 / (1000 + 1.1 * more)))
    assert noise_doubt(SETTINGS, enough, THREE, samples=1000) == ""
    barely = noisy_light(0.03, 0.03 * np.sqrt(1000 / (1000 + 0.8 * more)))
    assert noise_doubt(SETTINGS, barely, THREE) != ""
