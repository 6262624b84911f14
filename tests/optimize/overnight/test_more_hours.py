"""A finished night that is asked for more hours goes on from what it knows."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from optimize.overnight.context import REPORT_SECONDS
from optimize.overnight.job import EXTEND_FACTOR, REFINE_FACTOR, overnight
from optimize.overnight.result import OvernightResult
from optimize.overnight.status import status_of
from optimize.overnight.workers import FinishedJob
from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.reference.job import RenderJob, RenderResult
from render.scene.schema import Scene
from render.transport import TransportTable, load_table
from tests.optimize.overnight.conftest import TinyNight
from tests.optimize.overnight.tiny import rows

pytestmark = pytest.mark.slow

SECONDS, MORE = 60.0, 1.2
assert EXTEND_FACTOR < MORE < REFINE_FACTOR


class PretendedWorkers:
    """Invents renders; each takes the same time by a clock that nothing else moves."""

    count = 1

    def __init__(self, table: TransportTable) -> None:
        self.table, self.now = table, 0.0
        self.asked: list[RenderJob] = []

    def light(self, job: RenderJob) -> Array:
        """Return what the table says of the job, ``(fiber, node, target)``."""
        assert self.table.background is not None
        known = self.table.T if job.indented else self.table.background
        bend = int(np.abs(self.table.bends - job.bend).argmin())
        at_bend = np.maximum(known[:, :, bend], 1e-3 * known.mean())
        at_bend = at_bend.reshape(*at_bend.shape[:2], -1)
        weights = [interpolation_weights(self.table.phi, phi) for phi in np.array(job.phi).T]
        return np.maximum(np.einsum("nfj,fjt->fnt", np.stack(weights), at_bend), at_bend.min())

    def render(
        self,
        jobs: Sequence[RenderJob],
        state: Callable[[RenderJob], Path],
        tick: Callable[[int], None],
    ) -> Iterator[FinishedJob]:
        self.asked += jobs
        for index, job in enumerate(jobs):
            light = self.light(job)
            rng = np.random.default_rng(int(job.key[:16], 16))
            noise = 1 + 0.05 * rng.standard_normal((job.replicates, *light.shape))
            seconds = 0.5 + 1e-4 * job.samples
            self.now += seconds
            tick(job.samples)
            result = RenderResult(light * noise, np.zeros_like(light), seconds)
            yield FinishedJob(index, result, "pretended")

    def close(self) -> None:
        """Nothing was started."""


def batches(run: Path) -> list[str]:
    named = "SELECT name FROM decisions WHERE name LIKE '%/final batch%' AND value LIKE '%seeds%'"
    return [str(name) for (name,) in rows(run, named)]


@pytest.fixture
def workers(tiny_night: TinyNight, monkeypatch: pytest.MonkeyPatch) -> PretendedWorkers:
    """Return workers by whose clock a night is done, without fits and reports."""
    workers = PretendedWorkers(load_table(tiny_night.run / "table" / "reference.npz"))
    clock = SimpleNamespace(monotonic=lambda: workers.now)
    monkeypatch.setattr("optimize.overnight.store.time", clock)

    def train(scene: Scene, folder: Path, **rest: object) -> None:
        """Take the surrogate of the same sensor that is there; fitting one takes seconds."""
        shutil.copytree(tiny_night.run / "model", folder, dirs_exist_ok=True)

    monkeypatch.setattr("surrogate.train.train", train)

    def write_report(result: OvernightResult, run: Path) -> None:
        """Draw nothing, because nobody reads it, in the time that is set aside for it."""
        workers.now += REPORT_SECONDS

    monkeypatch.setattr("optimize.overnight.report.write_report", write_report)
    monkeypatch.setattr("surrogate.training.fit_time.seconds_per_step", lambda *_: 0.005)
    return workers


def test_hours_that_are_too_few_are_said_as_soon_as_renders_are_timed(
    tiny_night: TinyNight, tmp_path: Path, workers: PretendedWorkers
) -> None:
    def warned(seconds: float) -> list[str]:
        run = tmp_path / f"{seconds:g}"
        overnight(
            str(tiny_night.scene), run, hours=seconds / 3600, make_workers=lambda: workers
        )  # fmt: skip
        lines = (run / "log.txt").read_text().splitlines()
        found = [i for i, line in enumerate(lines) if " minutes are too few: " in line]
        table = next(i for i, line in enumerate(lines) if "Transport table ..." in line)
        assert all(i < table for i in found)
        return [lines[i] for i in found]

    (said,) = warned(6.0)
    before, count = workers.now, len(workers.asked)
    assert "0.1 minutes are too few: with the fewest samples this takes some " in said
    assert 60.0 * float(said.split(" some ")[1].split()[0]) > REPORT_SECONDS
    assert warned(120.0) == []
    assert workers.now - before < 132.0
    # The trials of a short night have smaller passes.
    short, long = workers.asked[0], workers.asked[count]
    assert 2 * short.chains < long.chains


def test_some_more_hours_verify_the_same_finalists_with_more_seeds(
    tiny_night: TinyNight, tmp_path: Path, workers: PretendedWorkers
) -> None:
    run = tmp_path / "run"

    def night(seconds: float) -> OvernightResult:
        scene, hours = str(tiny_night.scene), seconds / 3600
        return overnight(scene, run, hours=hours, make_workers=lambda: workers)

    first = night(SECONDS)
    kept = batches(run)
    assert workers.now == pytest.approx(SECONDS, rel=0.04)
    # Nothing to do: the same answer, at once.
    assert night(SECONDS).finalists[0].score == first.finalists[0].score
    assert batches(run) == kept

    more = night(MORE * status_of(run).seconds)
    for before, after in zip(first.finalists, more.finalists, strict=True):
        np.testing.assert_allclose(after.design.phi, before.design.phi)
    added = batches(run)[len(kept) :]
    assert added
    assert all("extension 1" in name for name in added)
    assert more.replicates > first.replicates
