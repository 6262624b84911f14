"""How far an effort errs in the ratio of two sensors' errors: what `MODEL_SPREAD` rests on.

``python -m tests.validation.dimension_spread FOLDER`` answers pairs of sensors on all efforts, in
minutes each, and keeps the answers in the folder. An effort's figure is the root of the mean square
of the difference of log ratios to the finest one, over both readers, with the baseline's and with
the best lights.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from optimize.dimensions import Variants, dimension_of
from optimize.dimensions.answer import EFFORT_NAMES, Answer, StudyEffort
from optimize.dimensions.kept_answers import KeptAnswers
from optimize.objectives import READERS
from render.errors import TactiluxError
from render.scene import load_scene

PAIRS = (
    ("digit", "pad.thickness=4"),
    ("digit", "pad.thickness=5"),
    ("digit", "coating.albedo=0.2"),
    ("digit", "pad.roughness=0.05"),
    ("gelsight-mini", "pad.thickness=3.5"),
    ("gelsight-mini", "coating.albedo=0.7"),
    ("finger20", "diffuser.thickness=1"),
    ("finger20", "pad.thickness=5"),
    ("digit-dome", "pad.thickness=7"),
    ("finger24", "diffuser.thickness=1"),
    ("finger24", "diffuser.sigma_s=8"),
)


def log_ratios(present: Answer, other: Answer) -> Iterator[float]:
    """Yield the logarithms of the ratios of errors."""
    for reader in READERS:
        for first, last in ((present.baseline, other.baseline), (present.best, other.best)):
            yield math.log(last.mean(reader) / first.mean(reader))


def main(folder: Path, pairs: tuple[tuple[str, str], ...] = PAIRS) -> None:
    """Print the log ratios of all pairs and the spread of each effort."""
    errors: dict[StudyEffort, list[float]] = {"drawn": [], "few": []}
    for name, text in pairs:
        scene = load_scene(name)
        variants = Variants(scene, [dimension_of(scene, text)])
        answers = KeptAnswers(variants, "sensor", 0, folder, None)
        (values,) = (one for one in variants if one != variants.present)
        found = {}
        for effort in EFFORT_NAMES:
            pair = answers.at(effort, variants.present), answers.at(effort, values)
            found[effort] = np.array([*log_ratios(*pair)])
            noise = [f"{one.photon_noise or 0.0:.1%}" for one in pair]
            print(f"{name:14} {text:22} {effort:10} {np.round(found[effort], 3)} noise {noise}")
        for effort, kept in errors.items():
            kept += [*(found[effort] - found["converged"])]
    for effort, kept in errors.items():
        each = np.array(kept).reshape(len(pairs), -1)
        print(f"{effort}: spread {np.sqrt(np.mean(each**2)):.3f}; by pair "
              f"{np.round(np.sqrt(np.mean(each**2, axis=1)), 3)}")  # fmt: skip


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except (IndexError, TactiluxError) as error:
        sys.exit(f"give a folder: {error}")
