"""docs/score.md says what its script measures today."""

from __future__ import annotations

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

import tactilux
from optimize.exploration import Stage

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "score.md").read_text(encoding="utf-8")
SCRIPT = ROOT / "examples" / "score.py"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = spec_from_file_location("score", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def rated(script: ModuleType) -> dict[str, Stage]:
    scene = tactilux.load_scene("finger20")
    return dict(script.anchors(scene, tactilux.load_model(scene)))


def test_the_page_holds_the_figures_of_its_designs(
    script: ModuleType, rated: dict[str, Stage]
) -> None:
    count, slope, tau = re.findall(r"Of (\d+) .* has ([\d.]+) hund.*tau ([\d.]+)\.", PAGE)[0]
    value = float(slope) / 100, float(tau), int(count)
    assert script.written(PAGE, script.tables(rated, value)) == PAGE


def test_s_orders_poor_usable_and_good_as_the_degrees_do(rated: dict[str, Stage]) -> None:
    order = [rated[name] for name in ("poor", "usable", "good")]
    scores = [stage.rating.score for stage in order]
    degrees = [stage.reader_error for stage in order]
    assert scores == sorted(scores)
    assert degrees == sorted(degrees, reverse=True)


def test_s_is_fooled_by_light_of_one_color_as_the_page_says(rated: dict[str, Stage]) -> None:
    fooled, poor = rated["fooled"], rated["poor"]
    assert fooled.rating.score > poor.rating.score + 50
    assert fooled.normal_error > 2 * poor.normal_error


def test_every_picture_of_the_page_is_there() -> None:
    names = re.findall(r"\((score-\w+\.png)\)", PAGE)
    assert len(names) == 4
    for name in names:
        picture = (ROOT / "docs" / name).read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) < 60_000


def test_every_word_that_the_first_screens_use_is_explained() -> None:
    glossary = PAGE.partition("## Words")[2]
    words = ("site", "bend", "facet", "cell", "level", "tau", "S", "M", "λ, lambda", "count",
             "PSSMLT", "surrogate", "reference", "degrees, readers")  # fmt: skip
    for word in words:
        assert f"\n| {word} | " in glossary
