"""A design file that is to be verified: the design, its scene, its camera and conventions."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optimize.design.design import Design, Rating, baseline_design
from optimize.design.design_file import load_design, load_saved
from optimize.design.limits import limits_of
from optimize.scoring.score_scale import Scale
from render.errors import DesignError
from render.scene.schema import Scene, load_scene, shipped_scenes


@dataclass(frozen=True, eq=False)
class Candidate:
    """A rated design file, opened: what is verified, and under which camera and conventions."""

    path: Path
    scene: Scene
    design: Design
    rating: Rating

    @property
    def digest(self) -> str:
        """12 hex digits of the design and its scene."""
        content = self.scene.hash.encode() + self.design.phi.tobytes() + self.design.power.tobytes()
        return hashlib.sha256(content).hexdigest()[:12]

    @property
    def baseline(self) -> Design:
        """The design to beat, with no LED above what the scene allows."""
        return limits_of(self.scene).dimmed(baseline_design(self.scene))

    @property
    def recolored(self) -> bool:
        """Whether the design differs from the baseline in its colors alone."""
        return bool(np.array_equal(self.design.phi, baseline_design(self.scene).phi))

    @property
    def scale(self) -> Scale:
        """The camera and the weights that it was rated with."""
        return Scale(self.rating.exposure, self.rating.lam, self.rating.conventions)


def open_candidate(path: Path, scene_name: str | None = None) -> Candidate:
    """Return the design in ``path`` with its scene, which is the one that the file names.

    Raises:
        DesignError: the file is bad, unrated, or for another scene than the one given.
    """
    saved = load_saved(path)
    if scene_name is None and saved.scene not in shipped_scenes():
        raise DesignError(
            f"{path} is for scene {saved.scene}, which does not come with tactilux: "
            "name its TOML file with --scene",
            field="scene",
            value=saved.scene,
        )
    scene = load_scene(scene_name or saved.scene)
    design = load_design(path, scene)
    if saved.rating is None:
        raise DesignError(
            f"{path} has no score, so its exposure and lam are unknown: rate it with "
            "tactilux explore",
            field="score",
        )
    return Candidate(path, scene, design, saved.rating)
