"""One HTML file to play with: no server, no network, and a policy inside that forbids both.

The page holds the transport table of a `Checker` at direction nodes as 16-bit integers, superposes
it, and rates what it shows by the metric itself and by the readers' expected errors in closed form.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from optimize.design import (
    CLIPPED,
    Array,
    Design,
    dimmed_baseline,
    limits_of,
    palette_in_file,
)
from optimize.objectives import ObjectiveName, sign_of, title_of, unit_of
from optimize.play.page_data import (
    large_pyramid,
    packed,
    palette_facts,
    reader_facts,
    sensor_facts,
)
from optimize.readers import CameraModel
from optimize.scoring import TableScorer
from optimize.search import (
    NominalScore,
    Objective,
    ReaderObjective,
    refine_locally,
    search_by_reader,
)
from optimize.search.colors import quick_colors
from optimize.ui.output import write_result
from optimize.ui.provenance import package_versions
from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.geometry import in_state
from render.progress import OnProgress
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import Checker

PHI_NODES = 13
"""Direction nodes: of finger20's scores 11 miss checker.onnx by up to 0.025 counts, 13 by 0.003."""
MAX_BYTES = 3_000_000
"""Size of a page."""
TESTED, SEARCHES = 64, 3
"""Random designs that page and model are compared on; rounds of colors and directions."""
SCRIPTS = (
    "model.js",
    "readers.js",
    "sensor_error.js",
    "place_error.js",
    "uphill.js",
    "sensor.js",
    "maps.js",
    "camera.js",
    "play.js",
)


@dataclass(frozen=True, eq=False)
class PlayPage:
    """What a page is made of.

    Arguments:
        scene: the sensor.
        checker: its model.
        start: what the page opens with; None is the baseline.
        optimum: the best design known by the objective; None searches one, as `explore` does.
        objective: what the page climbs and rates first.
        command: that made the page, for its footer.
    """

    scene: Scene
    checker: Checker
    start: Design | None = None
    optimum: Design | None = None
    objective: ObjectiveName = "sensor"
    command: str = ""

    def html(self, progress: OnProgress | None = None) -> str:
        """Return the page; ``progress`` is told how far a search for the optimum is.

        Raises:
            TableError: it would be larger than `MAX_BYTES`.
            GraphicsError: nothing here can draw the preview that its pictures are made of.
        """
        table = self.checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi))
        assert table.background is not None  # of a Checker
        scorer = TableScorer(table, self.checker.metadata.metric, limits=limits_of(self.scene))
        baseline = dimmed_baseline(self.scene)
        camera = CameraModel.of(self.scene)
        goal: Objective = NominalScore(scorer)
        if self.objective != "score":
            goal = ReaderObjective(scorer, self.scene, self.objective, camera)
        optimum = self.optimum or best_design(scorer, goal, baseline, progress)
        designs = {"baseline": baseline, "optimum": optimum, "start": self.start or baseline}
        skin = skin_light(self.scene, table.phi)
        text, places = packed(
            {
                "light": by_color(table.exposure * table.with_pad, table),
                "skin": by_color(table.exposure * skin, table),
            }
        )
        facts = sensor_facts(self.scene) | {
            "scene": {"name": self.scene.name, "hash": self.scene.hash},
            "level": table.level,
            "effort": table.effort,
            "phi": table.phi.tolist(),
            "tables": places,
            "tints": scorer.channels if table.by_channel else 1,
            "skinShape": skin.shape[3:5],
            "metric": self._metric(table),
            "objective": self.objective,
            "readers": reader_facts(self.scene, camera),
            "palette": palette_facts(self.scene.palette),
            # As a design file has it.
            "paletteInFile": palette_in_file(self.scene.palette),
            "halfWidth": self.checker.score_half_width,
            "clipped": CLIPPED,
            "designs": {name: _plain(design) for name, design in designs.items()},
            # For who lists pages; the page itself rates what it shows.
            "scores": {name: scorer.score(d.phi, d.power) for name, d in designs.items()},
            "shader": {
                "paths": _preview_shader("light_paths.glsl"),
                "sight": _preview_shader("sight.glsl"),
                "skin": _preview_shader("skin.glsl"),
                "relief": _part("relief.glsl"),
            },
            "versions": package_versions("numpy"),
        }
        title, unit = title_of(self.objective), unit_of(self.objective)
        sign, digits = sign_of(self.objective), 2 if unit else 1
        figures = [
            f"{sign * goal.value(design):.{digits}f}{unit}" for design in (baseline, optimum)
        ]
        html = self._filled(facts, text, scorer, (f"{title[0].upper()}{title[1:]}", *figures))
        if len(html.encode()) >= MAX_BYTES:
            raise TableError(
                f"the page would have {len(html.encode()) / 1e6:.1f} MB, allowed: below "
                f"{MAX_BYTES / 1e6:g} MB; a scene with fewer sites, facets, bends or states fits",
                field="page",
            )
        return html

    @property
    def notes(self) -> list[str]:
        """What who plays with it should know, one sentence each."""
        notes = [] if self.checker.metadata.rendered else [
            f"There is no trained model of {self.scene.name}, so this page is made on the "
            f"{self.checker.level_name}: good for trying and comparing, to be confirmed by "
            "tactilux verify."
        ]  # fmt: skip
        if self.scene.coating.lobe is not None:
            notes.append(
                "Scores and facets have the skin's lobe; the pictures and the light on the skin "
                "are drawn as if it scattered all of its light by Lambert's law."
            )
        return notes

    def _metric(self, table: TransportTable) -> dict[str, Any]:
        config = self.checker.metadata.metric
        return {
            "exposure": table.exposure,
            "lam": table.lam,
            "countMax": config.count_max,
            "ddof": config.ddof,
            "cyclic": config.cyclic,
            "conventions": asdict(config),
        }

    def _filled(
        self, facts: dict[str, Any], text: str, scorer: TableScorer, goal: tuple[str, ...]
    ) -> str:
        """Return the template with everything in it.

        ``goal`` is the name of the objective and what it is at the baseline and at the optimum.
        """
        style, script = _part("play.css"), '(() => {\n"use strict";\n'
        script += "\n".join(_part(name) for name in SCRIPTS) + "\n})();"
        source = self.checker.level_name
        environment = jinja2.Environment(
            autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
        )
        return environment.from_string(_part("play.html.j2")).render(
            scene=self.scene.name,
            scene_hash=self.scene.hash,
            level=source,
            source="the scene's model" if self.checker.metadata.rendered else f"the {source}",
            notes=self.notes,
            made=datetime.now(UTC).strftime("%d %B %Y"),
            confidence=f"{self.checker.coverage:.0%}",
            objective=self.objective,
            goal=goal,
            camera=CameraModel.of(self.scene).sentence,
            facets=scorer.facets,
            word=facts["axis"]["word"],
            turns=any(lamp.turns for lamp in self.scene.placed_lamps()),
            letters=", ".join(facts["palette"]["letters"][: self.scene.palette.led_count]),
            shots=self.scene.palette.shots,
            colors=", ".join(facts["palette"]["names"]),
            nodes=PHI_NODES,
            tested=TESTED,
            worst=f"{page_error(self.checker, scorer):.3f}",
            command=self.command,
            policy=(
                f"default-src 'none'; script-src '{inline_digest(script)}'; style-src "
                f"'{inline_digest(style)}'; base-uri 'none'; form-action 'none'"
            ),
            style=style,
            script=script,
            page=json.dumps(facts, allow_nan=False).replace("<", "\\u003c"),
            tables=text,
        )


def write_play(path: Path, page: PlayPage, progress: OnProgress | None = None) -> None:
    """Write the page to ``path``; ``progress`` is told how far a search for the optimum is.

    Raises:
        TableError: its table is too large for a page.
    """
    html = page.html(progress).encode()
    seal = f"<!-- seal {hashlib.sha256(html).hexdigest()} -->\n"
    write_result(path, html + seal.encode())


def best_design(
    scorer: TableScorer, goal: Objective, start: Design, progress: OnProgress | None = None
) -> Design:
    """Return the best design found by ``goal``: ``start``, or better and allowed."""
    found = best_score(scorer, start)
    if not isinstance(goal, ReaderObjective):
        return found
    near = [scorer.limits.nearest_design(design) for design in (start, found)]
    read = search_by_reader(scorer, goal, near, progress=progress)
    return read.design if read.score > goal.value(start) else start


def best_score(scorer: TableScorer, start: Design) -> Design:
    """Return a design whose S neither other colors of two lamps nor small turns improve."""
    phi = scorer.limits.nearest_directions(np.full(len(start.phi), math.pi / 2))
    best, score = start, scorer.score(start.phi, start.power)
    for round_ in range(SEARCHES):
        whole = scorer.limits.may_be_off or (best.colors >= 0).all()
        colors = [best.colors] if whole else []
        found = quick_colors(scorer, phi, starts=colors, restarts=8 if round_ == 0 else 0)
        design = scorer.design(phi, found.colors)
        optimum = refine_locally(scorer, design)
        if optimum.score <= score:
            break
        best, score, phi = optimum.design, optimum.score, optimum.design.phi
    return best


def by_color(values: Array, table: TransportTable) -> Array:
    """Return ``(fiber, phi_node, ...)``, an axis of channels, if ``table`` has it, before cells."""
    return np.moveaxis(values, -1, 2) if table.by_channel else values


def skin_light(scene: Scene, phi: Array) -> Array:
    """Return the preview's irradiance on the untouched coating, see `Preview.skin`.

    That of named states is on the same grid of the pad, through which the skin moves. Where albedos
    differ by channel it is that on a coating of the brightest that looks the same.
    """
    from render.preview import Preview

    # The preview of one sensor draws all bends, and that of each state its own.
    sensors: dict[Scene, list[float]] = {}
    for state in scene.state_axis:
        one, bend = in_state(scene, state)
        sensors.setdefault(one, []).append(bend)
    drawn = []
    for one, bends in sensors.items():
        with Preview(one, imprint=large_pyramid(one)) as preview:
            drawn.append(preview.skin(phi, np.array(bends)))
    # Patches are as large as the crown is high: all states are shown on the finest of their grids.
    finest = tuple(max(part.shape[axis] for part in drawn) for axis in (3, 4))
    light = np.concatenate([_resampled(part, finest) for part in drawn], axis=2)
    if not scene.by_channel:
        return light
    each = np.array([one.coating.reflectance for one in scene.one_albedo_scenes])
    reflected = each[list(scene.albedo_of_channel)]
    return np.asarray(light * reflected / reflected.max())


def _resampled(light: Array, shape: tuple[int, ...]) -> Array:
    """Return ``(fiber, node, bend, row, column, ...)`` with ``shape`` rows and columns.

    Linear between the middles of cells, and constant beyond the outer ones, as the page draws it.
    """
    if light.shape[3:5] == shape:
        return light
    along = []
    for old, new in zip(light.shape[3:5], shape, strict=True):
        at, to = ((np.arange(count) + 0.5) / count for count in (old, new))
        along.append(np.stack([np.interp(to, at, one) for one in np.eye(old)], axis=-1))
    return np.asarray(np.einsum("ar,bc,fnkrc...->fnkab...", *along, light))


def page_error(checker: Checker, scorer: TableScorer) -> float:
    """Return by how many counts scores on the page's table miss the model's, at most of `TESTED`.

    Random directions, colors and powers, seed 0.
    """
    rng, shape = np.random.default_rng(0), (TESTED, scorer.fibers)
    response = scorer.palette.matrix
    phi, colors = rng.uniform(0.0, np.pi, shape), rng.integers(0, len(response), shape)
    power = response[colors] * rng.uniform(0.0, 1.0, (*shape, 1))
    said = checker.run(phi, power, scorer.table.bends)["score"]
    own = [scorer.score(*design) for design in zip(phi, power, strict=True)]
    return float(np.abs(np.array(own) - said).max())


def _plain(design: Design) -> dict[str, Any]:
    return {"angles_deg": np.degrees(design.phi).tolist(), "power": design.drive.tolist()}


def _part(name: str) -> str:
    return (resources.files("optimize.play") / "page" / name).read_text(encoding="utf-8")


def _preview_shader(name: str) -> str:
    return (resources.files("render.preview") / "shaders" / name).read_text(encoding="utf-8")


def inline_digest(text: str) -> str:
    """Return the hash by which a content security policy knows an inline script or style."""
    digest = hashlib.sha256(text.encode()).digest()
    return "sha256-" + base64.b64encode(digest).decode("ascii")
