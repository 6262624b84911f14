"""How much is rendered for a frontier: given, or what fills a number of minutes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optimize.frontier.held_out import HeldOutDesigns
from optimize.frontier.rendered_levels import PathTracer
from optimize.ui.output import OutputError
from render.reference import RenderCost, measure_render_cost, stored_plan

PLAN = "plan.json"
SHORT_DIVISORS = (32, 8)
"""How many times fewer samples the short rendered rows get than the reference."""
TRACER_SAMPLES = (4, 16)
"""Samples per pixel of the path tracer's rows."""
TABLE_DIVISOR = 2
"""How many times fewer samples a transport table gets, where none is given."""
PATH_TRACER_FRACTION, FIT_SECONDS = 0.15, 120.0
"""Part of the minutes for the path tracer, and what the fits take."""


@dataclass(frozen=True)
class FrontierPlan:
    """What is rendered; kept in the run directory, so that a resumed run renders the same.

    Arguments:
        scene_hash, seed, designs: whose designs, which, and how many.
        minutes: that the rest was chosen for; 0 when ``samples`` were given.
        samples: per fiber and facet, of the reference.
        short: the same, of the short rows.
        spp: per pixel, of the path tracer's rows.
    """

    scene_hash: str
    seed: int
    designs: int
    minutes: float
    samples: int
    short: list[int]
    spp: list[int]

    @property
    def table_samples(self) -> int:
        """Samples of a transport table, where none is given."""
        return max(1, self.samples // TABLE_DIVISOR)


def check_folder(folder: Path) -> None:
    """Refuse a directory that holds something else.

    Raises:
        OutputError: ``folder`` is a file, or holds files but no plan.
    """
    foreign = folder.exists() and (
        not folder.is_dir() or (any(folder.iterdir()) and not (folder / PLAN).is_file())
    )
    if foreign:
        raise OutputError(
            f"{folder} holds files but no frontier ({PLAN}), so it is left alone: choose another "
            "place with --out",
            field="out",
            value=str(folder),
        )


def make_frontier_plan(
    designs: HeldOutDesigns,
    folder: Path,
    *,
    seed: int,
    minutes: float,
    samples: int | None,
    renders_table: bool,
) -> FrontierPlan:
    """Return the plan in ``folder`` when it answers the same request, or a new one.

    Arguments:
        designs: what is rendered.
        folder: of the run.
        seed: of the designs.
        minutes: of rendering in all, unless ``samples`` says it.
        samples: of the reference, per fiber and facet.
        renders_table: whether a transport table has to be rendered as well.
    """
    wanted: dict[str, Any] = {
        "scene_hash": designs.scene.hash,
        "seed": seed,
        "designs": len(designs),
    }

    def make() -> FrontierPlan:
        chosen, spp, spent = samples, list(TRACER_SAMPLES), 0.0
        if chosen is None:
            spent = minutes
            seconds = 60.0 * minutes - FIT_SECONDS
            chosen = _affordable(
                designs, (1.0 - PATH_TRACER_FRACTION) * seconds, renders_table=renders_table
            )
            spp = _affordable_samples(designs, PATH_TRACER_FRACTION * seconds)
        short = [max(1, chosen // factor) for factor in SHORT_DIVISORS]
        return FrontierPlan(minutes=spent, samples=chosen, short=short, spp=spp, **wanted)

    given = {"minutes": minutes} if samples is None else {"samples": samples}
    return stored_plan(folder / PLAN, FrontierPlan, wanted | given, make)


def _affordable(designs: HeldOutDesigns, seconds: float, *, renders_table: bool) -> int:
    """Return the reference's samples that fill ``seconds`` together with the shorter renders."""
    scene = designs.scene
    cost = measure_render_cost(scene, designs.nodes)
    # The longest of the short renders is made once more with small steps, and for one design.
    divisors = [1, *SHORT_DIVISORS, SHORT_DIVISORS[-1], SHORT_DIVISORS[-1]]
    divisors += [TABLE_DIVISOR] if renders_table else []
    renders = [1.0 / divisor for divisor in divisors]
    return cost.samples_within(seconds, renders * len(scene.bending.angles), SHORT_DIVISORS[0])


def _affordable_samples(designs: HeldOutDesigns, seconds: float) -> list[int]:
    """Return samples per pixel of two rows, four times apart, that fill ``seconds``."""
    tracer = PathTracer(designs.scene)
    spent = []
    for spp in (1, 1, 9):
        began = time.monotonic()
        tracer.radiance(designs.phi[0], designs.power[0], spp, seed=0)
        spent.append(time.monotonic() - began)
    # The first one compiles, as the first of the rows does.
    slope = RenderCost.fitted((1, 9), spent[1:]).per_sample
    cost = RenderCost(max(spent[0] - slope, 0.0), slope)
    spp = cost.samples_within(seconds / len(designs), [1.0, 4.0])
    return [spp, 4 * spp]
