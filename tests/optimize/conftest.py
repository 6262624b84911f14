"""What tests of the optimizer share: an invented sensor, stages and a night."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optimize.design import (
    PARTS,
    Array,
    Design,
    Rating,
    ScoreSettings,
    baseline_design,
    keep_scene,
    limits_of,
)
from optimize.exploration import Stage
from optimize.objectives import READERS, ReaderName
from optimize.overnight.report import write_report
from optimize.overnight.result import (
    ConvergencePoint,
    Finalist,
    OvernightResult,
    RenderedFigure,
)
from optimize.readers import ReaderFigures, Reading
from render.chebyshev import chebyshev_nodes
from render.metric import (
    choose_exposure,
    choose_lambda,
    design_score,
    image_counts,
    site_metric,
)
from render.scene import Scene, load_scene, standalone
from render.transport import TransportTable
from surrogate.runtime import Checker

MODELS = Path(__file__).parents[2] / "models"
NOISE = 0.01  # relative, of invented renders

MakeTable = Callable[..., TransportTable]
StageMaker = Callable[[float, float, float], list[Stage]]


def invent_table(
    fibers: int = 8,
    nodes: int = 5,
    bends: int = 2,
    sites: int = 4,
    facets: int = 6,
    *,
    error: float = 0.0,
    lam: float | None = None,
    level: str = "reference",
    seed: int = 0,
) -> TransportTable:
    """Return a table of fibers around a disc, whose light fades with distance and angle."""
    rng = np.random.default_rng(seed)
    around = 2 * np.pi * (np.arange(fibers) + 0.5) / fibers
    inward = -np.stack([np.sin(around), np.cos(around)], axis=-1)
    along = np.stack([inward[:, 1], -inward[:, 0]], axis=-1)
    phi = chebyshev_nodes(nodes, 0.0, np.pi)
    beam = np.cos(phi)[:, None] * along[:, None] + np.sin(phi)[:, None] * inward[:, None]
    ray = rng.uniform(-0.5, 0.5, (sites, 2)) + inward[:, None]
    distance = np.linalg.norm(ray, axis=-1)
    azimuth = 2 * np.pi * np.arange(facets) / facets
    normal = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    spot = np.exp(2.0 * np.einsum("fjx,fsx->fjs", beam, ray) / distance[:, None])
    shade = np.maximum(1.0 - np.einsum("kx,fsx->fsk", normal, ray), 0.05)
    fade = np.exp(-np.linspace(0.0, 0.5, bends)[:, None, None] * distance) / distance**2
    transport = np.einsum("fjs,fsk,bfs->fjbsk", spot, shade, fade)
    ahead = np.full(fibers, np.pi / 2)
    thirds = np.eye(3)[np.arange(fibers) * 3 // fibers]
    plain = TransportTable(transport, error * transport, phi, 1.0, 0.0)
    exposure = choose_exposure(np.einsum("fbsk,fc->bskc", plain.at(ahead), thirds))
    if lam is None:
        lam = choose_lambda(image_counts(plain.at(ahead), thirds, exposure))
    return TransportTable(transport, error * transport, phi, exposure, lam, level=level)


@pytest.fixture
def make_table() -> MakeTable:
    return invent_table


@pytest.fixture(scope="session")
def finger20() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="session")
def sample_stages(finger20: Scene) -> StageMaker:
    """Make baseline, colors and optimized stages with given scores, each plus minus 3."""
    return lambda *scores: _stages(finger20, scores)


def read_by(degrees: float, shape: tuple[int, int]) -> Reading:
    """Return a reading of ``shape`` (state, site) that misses by so much everywhere."""
    figures = ReaderFigures(np.full(2, degrees), np.full(2, 2.0 * degrees), np.full(shape, degrees))
    return Reading(figures, figures, 1.0, 1.0)


def _stages(scene: Scene, scores: tuple[float, ...]) -> list[Stage]:
    """Return stages whose other figures are made up, for what only shows them."""
    rng = np.random.default_rng(7)
    base = baseline_design(scene)
    shape = (len(scene.bending.angles), scene.sites.count)
    mixed = np.arange(scene.lamp_count) % 3
    designs = [
        base,
        Design.of_colors(base.phi, mixed),
        Design.of_colors(
            limits_of(scene).nearest_directions(rng.uniform(0.5, 2.6, scene.lamp_count)), mixed
        ),
    ]
    texts = [
        ("baseline", "Baseline", ""),
        ("colors", "Colors", "the color search"),
        ("optimized", "Optimized", "the fiber directions"),
    ]
    return [
        Stage(
            scene=scene,
            key=key,
            title=title,
            change=change,
            design=design,
            rating=Rating(
                level="surrogate",
                score=score,
                interval=(score - 3, score + 3),
                mean=score + 20,
                spread_sites=12.0,
                spread_bends=8.0,
                settings=ScoreSettings(exposure=3000.0, lam=84.0),
            ),
            metric=rng.uniform(20, 80, shape),
            counts=rng.uniform(0, 255, (*shape, scene.indenter.faces, 3)),
            clipped=0.0,
            domain_excess=0.0,
            reading=read_by(300.0 / score, shape),
        )
        for (key, title, change), design, score in zip(texts, designs, scores, strict=True)
    ]


@pytest.fixture(scope="session")
def finger20_checker(finger20: Scene) -> Checker:
    return Checker.load(MODELS / "finger20", finger20.hash)


@pytest.fixture(scope="session")
def finished_night(finger20: Scene, finger20_checker: Checker) -> OvernightResult:
    """Return a night of five finalists and two rounds."""
    rng = np.random.default_rng(11)
    straight = np.full(20, np.pi / 2)
    # What tactilux explore finds on the shipped surrogate, to a degree.
    colors = [0, 0, 0, 0, 2, 0, 0, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 0, 0]
    degrees = [69, 78, 100, 120, 100, 65, 141, 117, 76, 89]
    degrees += [102, 111, 106, 109, 84, 80, 104, 87, 68, 62]
    turned = np.radians(degrees)
    designs = {
        "baseline": baseline_design(finger20),
        "colors": Design.of_colors(straight, colors),
        "thesis": Design.of_colors(straight + 0.1, colors),
        "winner": Design.of_colors(turned, colors),
        "runner-up": Design.of_colors(0.5 * (straight + turned), colors),
    }
    finalists = tuple(
        _finalist(finger20, finger20_checker, rng, key, design) for key, design in designs.items()
    )
    first = finalists[0].score
    finalists = tuple(
        entry if entry.key == "baseline"
        else Finalist(**{**vars(entry), "gain": entry.score - first, "gain_se": 0.9,
                         "errors": read_errors(1.8, -0.4)})
        for entry in finalists
    )  # fmt: skip
    rows = list(zip(("baseline", "best", "uncertain", "random"), finalists, strict=False))
    steps = tuple(
        ConvergencePoint(f"round {number}", role, entry.score - 4 / number, 1.5, entry.predicted)
        for number in (1, 2)
        for role, entry in rows
    )
    return OvernightResult(
        scene=finger20,
        objective="score",
        replicates=16,
        finalists=finalists,
        winner="winner",
        verdict=(
            "The winner is better than the baseline (95% interval of the difference 30 to 36).",
            "The winner and the runner-up tie (95% interval of the difference -1.2 to 2.0).",
        ),
        steps=steps,
        trade=(
            ("preview", 0.004, 0.028, 0.087, 1.94, 0.93),
            ("checker.onnx", 0.0006, 0.013, 0.029, 0.95, 0.96),
            ("PSSMLT, 96 samples", 9.0, 0.03, 0.07, 2.4, 0.91),
        ),
        facts=(("Scene", f"finger20, {finger20.hash}"), ("Seed", "0"), ("Budget", "8 h")),
    )


def read_errors(value: float, gain: float | None) -> dict[ReaderName, RenderedFigure]:
    """Return what both readers make of a finalist, in degrees."""
    se = None if gain is None else 0.05
    return {reader: RenderedFigure(value, 0.04, gain, se, value + 0.1) for reader in READERS}


@pytest.fixture(scope="session")
def night_report(
    finished_night: OvernightResult,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """Return the report of the night, made from its files."""
    run = tmp_path_factory.mktemp("night")
    keep_scene(run, standalone("finger20"))
    finished_night.save(run)
    return write_report(OvernightResult.load(run), run)


@pytest.fixture
def run_directory(tmp_path: Path, finished_night: OvernightResult) -> Path:
    """Return a directory in which the night is kept."""
    run = tmp_path / "run"
    keep_scene(run, standalone("finger20"))
    finished_night.save(run)
    return run


def _finalist(
    scene: Scene, checker: Checker, rng: np.random.Generator, key: str, design: Design
) -> Finalist:
    bends = np.array(scene.bending.angles)
    found = checker.run(design.phi[None], design.power[None], bends)
    predicted = np.asarray(found["counts"][0], dtype=np.float64)
    counts: Array = np.clip(predicted * (1 + NOISE * rng.standard_normal(predicted.shape)), 0, 255)
    metric = np.asarray(site_metric(counts, checker.lam))
    parts = design_score(metric)
    values = {name: float(getattr(parts, name)) for name in PARTS}
    # Student's t with 15 degrees of freedom.
    interval = values["score"] - 2.131 * 0.4, values["score"] + 2.131 * 0.4
    settings = ScoreSettings(checker.exposure, checker.lam)
    return Finalist(
        key=key,
        design=design,
        rating=settings.rating("reference", values, interval),
        se=0.4,
        gain=None,
        gain_se=None,
        predicted=float(found["score"][0]),
        predicted_reach=checker.score_half_width,
        errors=read_errors(2.2, None),
        counts=counts,
        counts_se=NOISE * predicted,
        predicted_counts=predicted,
        metric=metric,
        metric_se=np.full_like(metric, 1.0),
    )
