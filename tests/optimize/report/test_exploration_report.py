"""The report stands alone, says what was found, and does not hide what is doubtful."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from optimize.exploration import Stage, stage_to_json
from optimize.mounting import mount
from optimize.report import print_scores, render_report, warnings, wiring_context
from optimize.report.exploration_report import caveats
from render.scene import load_scene
from render.scene.scene_file import scene_from_text, scene_text
from surrogate.runtime import RankingTest
from tests.optimize.conftest import read_by

RELIABLE = RankingTest(tau=0.96, factor=0.4, samples=12000, unconverged=0.0)
NOISY = RankingTest(tau=0.41, factor=20.0, samples=200, unconverged=0.0)
PIXEL = b"\x89PNG fake"


StageMaker = Callable[[float, float, float], list[Stage]]


def report(stages: list[Stage], ranking: RankingTest = RELIABLE) -> str:
    """Return the report of ``stages`` with invented pictures and texts."""
    keys = [stage.key for stage in stages]
    names = [f"{kind}-{key}" for kind in ("scheme", "metric", "facets") for key in keys]
    names += [f"preview-{key}-{index}" for key in keys for index in range(3)]
    return render_report(
        stages,
        dict.fromkeys([*names, "convergence"], PIXEL),
        ranking=ranking,
        search_note="1000 designs in 3 s.",
        caveats=["Off by 2 counts on <held-out> designs."],
        facts=[("Scene", stages[0].scene.hash)],
        errors=[
            {
                "name": "network",
                "facet_median": 0.02,
                "facet_p95": 0.05,
                "score_median": 0.5,
                "score_p95": 1.5,
                "kendall_tau": 0.91,
            }
        ],
        confidence="90%",
        made="1 January 2026",
        steps=[("Let renders decide:", "tactilux verify design.json")],
        play="play.html",
        wiring=wiring_context(mount(stages[-1].scene, stages[-1].design), stages[-1].title),
    )


def test_light_goes_through_a_diffuser_only_where_there_is_one() -> None:
    def told(name: str) -> str:
        about = {"level": "surrogate", "effort": "converged", "level_name": "surrogate (converged)"}
        metadata = SimpleNamespace(rendered=False)
        checker = SimpleNamespace(**about, coverage=0.9, score_half_width=1.0, metadata=metadata)
        found: Any = SimpleNamespace(scene=load_scene(name), checker=checker)
        return " ".join(caveats(found))

    assert "light that was traced through the diffuser to every facet" in told("finger20")
    assert "light that was traced to every facet" in told("digit")
    assert "diffuser" not in told("digit")


def test_the_report_needs_no_other_file_and_no_network(sample_stages: StageMaker) -> None:
    html = report(sample_stages(30, 40, 50))
    sources = re.findall(r'src="([^"]*)"', html)
    assert len(sources) == 1 + 3 * 3 + 2 * 3 + 1 + 1
    assert re.findall(r'href="([^"]*)"', html) == ["play.html"]
    assert all(re.match(r"data:image/(png|svg\+xml);base64,", source) for source in sources)
    assert not re.search(r"<script|<link|@import|url\(|https?://", html)


def test_the_wiring_sheet_has_a_row_for_every_fiber(sample_stages: StageMaker) -> None:
    stages = sample_stages(30, 40, 50)
    sheet = report(stages).partition("Wiring sheet")[2]
    row = r'<td data-label="Fiber">(\d+)</td>\s*<td data-label="Edge" class="text">(\w+)</td>'
    rows = re.findall(row, sheet)
    assert [int(number) for number, _ in rows] == list(range(20))
    assert [edge for _, edge in rows].count("tip") == 4


def test_text_is_escaped(sample_stages: StageMaker) -> None:
    assert "&lt;held-out&gt;" in report(sample_stages(30, 40, 50))


def test_the_summary_says_how_much_was_won_and_by_what(sample_stages: StageMaker) -> None:
    html = report(sample_stages(30, 42, 50))
    assert "gain of 20.0 (+67%)" in html
    assert "+12.0 by the color search and +8.0 by the fiber directions" in html


STATE = """
[[states]]
name = "pressed"
radius = { value = 80.0, unit = "mm", source = "test" }
"""


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (scene_text("finger20"), "bend"),
        (scene_text("digit-dome") + STATE, "state"),
        (scene_text("digit-dome"), ""),
    ],
    ids=["bends", "states", "one state"],
)
def test_scores_spread_over_what_the_scene_has(
    sample_stages: StageMaker, text: str, word: str
) -> None:
    first, *others = sample_stages(30, 40, 50)
    stages = [replace(first, scene=scene_from_text(text, "scene", Path())), *others]
    page = report(stages)
    for other in {"bend", "state"} - {word}:
        assert not re.search(f"over {other}s|every {other}|site and {other}", page)
    assert len(stages[0].scene.state_titles) == (1 if not word else len(stages[0].scene.state_axis))
    if word:
        assert f"Spread<br>over {word}s" in page
        assert f"− its spread over {word}s; higher" in page
        assert f"every site and {word}, " in page
        assert f"and over {word}s from 8.0 to 8.0." in page
    else:
        assert not re.search(r"\bbend|\bstate", page)
        assert f'alt="{stages[0].title}">' in page
        assert "− its spread over sites; higher" in page
        assert "its spread over sites from 12.0 to 12.0." in page
    assert page.count("<td") == report(sample_stages(30, 40, 50)).count("<td") - 3 * (not word)


def test_degrees_stand_beside_the_score(sample_stages: StageMaker) -> None:
    html = report(sample_stages(30, 42, 50))
    assert "misses surface normals by 6.00° on average; with the baseline, by 10.00°" in html
    assert re.findall(r"<td>(\d+\.\d\d)°</td></tr>", html) == ["10.00", "7.14", "6.00"]
    assert "What the figures mean" in html


def test_a_score_that_rises_while_normals_are_read_worse_is_doubted(
    sample_stages: StageMaker,
) -> None:
    stages = sample_stages(30, 40, 50)
    stages[-1] = replace(stages[-1], reading=read_by(12.0, stages[-1].reading.place.map.shape))
    assert any("S rose, but normals are read worse" in text for text in warnings(stages, RELIABLE))


def test_a_sure_gain_needs_no_warning(sample_stages: StageMaker) -> None:
    assert warnings(sample_stages(30, 40, 50), RELIABLE) == []


def test_overlapping_intervals_are_called_uncertain(sample_stages: StageMaker) -> None:
    assert "overlap" in warnings(sample_stages(30, 32, 34), RELIABLE)[0]


def test_a_search_that_found_nothing_says_so(sample_stages: StageMaker) -> None:
    assert "nothing better" in warnings(sample_stages(30, 30, 30), RELIABLE)[0]


@pytest.mark.parametrize(
    ("change", "word"),
    [({"domain_excess": 0.2}, "extrapolation"), ({"clipped": 0.05}, "saturate")],
)
def test_extrapolation_and_clipping_raise_a_warning(
    sample_stages: StageMaker, change: dict[str, float], word: str
) -> None:
    stages = sample_stages(30, 40, 50)
    stages[-1] = replace(stages[-1], **change)
    assert any(word in text for text in warnings(stages, RELIABLE))


def test_a_monochrome_optimum_is_flagged(sample_stages: StageMaker) -> None:
    stages = sample_stages(30, 40, 50)
    design = stages[-1].design
    one = type(design).of_colors(design.phi, [0] * 20)
    stages[-1] = replace(stages[-1], design=one)
    assert any("monochrome" in text for text in warnings(stages, RELIABLE))


def test_fibers_that_would_meet_in_their_holder_raise_a_warning(sample_stages: StageMaker) -> None:
    stages = sample_stages(30, 40, 50)
    phi = stages[-1].design.phi.copy()
    phi[3], phi[4] = 2.6, 0.5
    stages[-1] = replace(stages[-1], design=replace(stages[-1].design, phi=phi))
    assert any("cannot be built: fibers 3 and 4" in text for text in warnings(stages, RELIABLE))


def test_one_color_everywhere_is_not_called_a_gain(sample_stages: StageMaker) -> None:
    stages = sample_stages(30, 40, 96)
    design = stages[-1].design
    stages[-1] = replace(stages[-1], design=type(design).of_colors(design.phi, [0] * 20))
    html = report(stages)
    assert "96.0 for the optimized design and 30.0 for the baseline" in html
    assert "this is not a gain" in html
    assert "gain of" not in html


def test_a_surrogate_that_cannot_rank_designs_says_so_first_and_claims_nothing(
    sample_stages: StageMaker,
) -> None:
    stages = sample_stages(30, 40, 96)
    html = report(stages, NOISY)
    assert "gain of" not in html
    assert "Kendall" in warnings(stages, NOISY)[0]
    assert html.index("train with at least 20 times the samples") < html.index("<table")


def of_converged_light(stages: list[Stage], noise: float) -> list[Stage]:
    return [
        replace(
            stage,
            rating=replace(stage.rating, level="surrogate", effort="converged"),
            photon_noise=noise,
        )
        for stage in stages
    ]


def test_the_level_is_said_with_the_noise_of_its_photons(sample_stages: StageMaker) -> None:
    table = io.StringIO()
    stages = of_converged_light(sample_stages(30, 40, 50), 0.0123)
    print_scores(table, stages, 0.9)
    said = " ".join(table.getvalue().split())
    assert "surrogate (converged), photon noise 1.2% of the color" in said
    assert stage_to_json(stages[0])["photon_noise"] == 0.0123
    assert stage_to_json(sample_stages(30, 40, 50)[0])["photon_noise"] is None


def test_colors_that_stay_noisy_are_a_warning(sample_stages: StageMaker) -> None:
    stages = sample_stages(30, 90, 150)
    quiet, noisy = (of_converged_light(stages, noise) for noise in (0.029, 0.043))
    assert warnings(quiet, RELIABLE) == warnings(stages, RELIABLE)
    (said,) = (text for text in warnings(noisy, RELIABLE) if "light paths" in text)
    assert "4.3%" in said
    assert "tactilux verify" in said
