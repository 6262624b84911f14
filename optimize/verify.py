"""Verification: a design against the baseline at level 2, with honest error bars.

Both designs are rendered with the same seeds. Scores come from the renderer's independent
replicates by the jackknife, because noise makes the plain score too low, and the difference is
jackknifed jointly so that noise which both share cancels.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from render.reference import Estimate, Progress, render_transport
from surrogate.checker import Checker

from optimize.design import Array, Design, baseline_design
from optimize.design_file import SavedDesign, load_design, load_saved
from optimize.jackknife import JackknifeEstimate, jackknife
from render.errors import DesignError
from render.metric import MetricConfig, clipped_fraction, design_score, image_counts, site_metric
from render.scene import Scene, load_scene, shipped_scenes

PARTS = ("score", "mean", "spread_sites", "spread_bends")


@dataclass(frozen=True)
class Camera:
    """How transport becomes counts and counts a metric, fixed by the design's file."""

    exposure: float
    lam: float
    conventions: MetricConfig

    def parts(self, transport: Array, power: Array) -> Array:
        """Return score, mean, spread over sites and over bends, ``(4,)``.

        ``transport`` ``(F, B, S, K)`` and ``power`` ``(F, 3)``.
        """
        counts = image_counts(transport, power, self.exposure, self.conventions)
        score = design_score(site_metric(counts, self.lam, self.conventions), self.conventions)
        return np.array([float(getattr(score, part)) for part in PARTS])

    def clipped(self, transport: Array, power: Array) -> float:
        """Return the fraction of facets that clip."""
        counts = image_counts(transport, power, self.exposure, self.conventions)
        return float(clipped_fraction(counts, self.conventions))


@dataclass(frozen=True)
class Measured:
    """One design at level 2: jackknife estimates by part of the score, and clipped facets."""

    parts: dict[str, JackknifeEstimate]
    clipped: float

    @property
    def score(self) -> JackknifeEstimate:
        """S of eq. (4.7)."""
        return self.parts["score"]


@dataclass(frozen=True)
class Verification:
    """What the reference renderer says about a design and about the surrogate."""

    scene: Scene
    baseline: Measured
    design: Measured
    difference: JackknifeEstimate
    surrogate_score: float
    render_seconds: float
    seeds: tuple[int, ...]
    mutations: int
    checkpoint: Path

    @property
    def verdict(self) -> str:
        """The conclusion in one sentence."""
        low, high = self.difference.interval()
        if low > 0:
            return "The design is better than the baseline by more than its error bars."
        if high < 0:
            return "The design is worse than the baseline by more than its error bars."
        return "This is a tie: the difference is within its error bars; render longer to decide."

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        both = {"baseline": self.baseline, "design": self.design}
        return {
            **{name: {"score": one.score.value, "se": one.score.se} for name, one in both.items()},
            "difference": {
                "value": self.difference.value,
                "interval": list(self.difference.interval()),
            },
            "surrogate": {
                "score": self.surrogate_score,
                "error": self.surrogate_score - self.design.score.value,
            },
            "render_seconds": self.render_seconds,
            "seeds": list(self.seeds),
        }


def open_design(path: Path, scene: str | None) -> tuple[Scene, Design, SavedDesign]:
    """Return scene, design and file content; the scene is the one that the file names.

    Raises:
        DesignError: the file is bad, unrated, or for another scene than the one given.
    """
    saved = load_saved(path)
    if scene is None and saved.scene not in shipped_scenes():
        raise DesignError(
            f"{path} is for scene {saved.scene}, which does not come with tactilux: "
            "name its TOML file with --scene",
            field="scene",
            value=saved.scene,
        )
    loaded = load_scene(scene or saved.scene)
    design = load_design(path, loaded)
    if saved.rating is None:
        raise DesignError(
            f"{path} has no score, so its exposure and lam are unknown: rate it with "
            "tactilux explore",
            field="score",
        )
    return loaded, design, saved


def verify(
    path: Path,
    model: Checker,
    *,
    mutations: int,
    seeds: Sequence[int],
    scene: str | None = None,
    checkpoint: Path | None = None,
    progress: Callable[[str, Progress], None] | None = None,
) -> Verification:
    """Render the design in ``path`` and the baseline, and compare them.

    Arguments:
        path: a rated design.json.
        model: the surrogate whose prediction is checked.
        mutations: per design and seed.
        seeds: common to both designs.
        scene: scene file, where the design names one that is not shipped.
        checkpoint: directory from which an interrupted verification goes on; by default beside
            the design, named by its content.
        progress: called with the name of the design being rendered.
    """
    loaded, design, saved = open_design(path, scene)
    assert saved.rating is not None
    rating = saved.rating
    camera = Camera(rating.exposure, rating.lam, rating.conventions)
    folder = checkpoint or default_checkpoint(path, loaded, design)
    bends = np.array(loaded.bending.angles)

    def render(name: str, phi: Array) -> Estimate:
        return render_transport(
            loaded,
            phi[:, None],
            bends,
            mutations=mutations,
            seeds=seeds,
            checkpoint=folder / name,
            progress=None if progress is None else lambda state: progress(name, state),
        )

    baseline = baseline_design(loaded)
    first = render("baseline", baseline.phi)
    # A design that differs in colours alone has the transport of the baseline: light is linear.
    same = np.array_equal(baseline.phi, design.phi)
    second = first if same else render("design", design.phi)

    pair = np.stack([first.replicates[:, :, 0], second.replicates[:, :, 0]], axis=1)
    powers = np.stack([baseline.power, design.power])
    measured = [_measure(camera, pair[:, i], powers[i]) for i in (0, 1)]
    predicted = model.run(design.phi[None], design.power[None], bends)
    return Verification(
        scene=loaded,
        baseline=measured[0],
        design=measured[1],
        difference=jackknife(
            lambda both: camera.parts(both[1], powers[1])[0] - camera.parts(both[0], powers[0])[0],
            pair,
        ),
        surrogate_score=float(predicted["score"][0]),
        render_seconds=first.seconds + (0.0 if same else second.seconds),
        seeds=tuple(seeds),
        mutations=mutations,
        checkpoint=folder,
    )


def default_checkpoint(path: Path, scene: Scene, design: Design) -> Path:
    """Return the directory beside the design that belongs to exactly this design and scene."""
    content = scene.hash.encode() + design.phi.tobytes() + design.power.tobytes()
    return path.parent / f"verify-{hashlib.sha256(content).hexdigest()[:12]}"


def _measure(camera: Camera, replicates: Array, power: Array) -> Measured:
    """Jackknife every part of the score of ``replicates`` ``(R, F, B, S, K)``."""
    parts = {
        name: jackknife(lambda mean, i=i: float(camera.parts(mean, power)[i]), replicates)  # type: ignore[misc]
        for i, name in enumerate(PARTS)
    }
    return Measured(parts, camera.clipped(replicates.mean(axis=0), power))
