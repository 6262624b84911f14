"""Three levels have three names, and no other word stands for one but in files of before."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest

from optimize.design import ScoreSettings, baseline_design, load_design_file, save_design
from render.errors import TableError
from render.levels import EARLIER, EFFORTS, LEVELS, level_name, level_of, read_level
from render.scene import load_scene
from render.transport import TransportTable, load_table
from surrogate.runtime import Checker
from surrogate.runtime.metadata import NOISE, NONE, held_out_row

ROOT = Path(__file__).parents[1]
SOURCES = [ROOT / "tactilux.py"] + [
    path for name in ("render", "surrogate", "optimize", "hw") for path in (ROOT / name).rglob("*")
]
MAP = ROOT / "render" / "levels.py"
NUMBERED = re.compile(r"level [012]\b|\b[012], (preview|surrogate|reference)")


def spoken(path: Path) -> list[str]:
    """Return the texts of a file but for docstrings: what a program can print or store."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return [text]
    tree = ast.parse(text)
    silent = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return [str(node.value) for node in constants if id(node) not in silent]


def test_no_program_says_a_level_of_before_or_by_its_number() -> None:
    for path in SOURCES:
        for text in spoken(path) if path.suffix in {".py", ".js", ".j2"} else ():
            assert path == MAP or not any(earlier in text for earlier in EARLIER), path
            assert not NUMBERED.search(text), path


def test_no_document_says_a_level_of_before() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *ROOT.glob("*/README.md")]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not any(earlier in text for earlier in EARLIER), page
        assert not NUMBERED.search(text), page


def levels_given(path: Path) -> list[object]:
    """Return what a source gives for a level by name: arguments, keys of dictionaries, fields."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == "level":
            found.append(node.value)
        if isinstance(node, ast.Dict):
            pairs = zip(node.keys, node.values, strict=True)
            found += [v for k, v in pairs if isinstance(k, ast.Constant) and k.value == "level"]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found += [node.value] * (node.target.id == "level")
    return [node.value for node in found if isinstance(node, ast.Constant)]


def test_every_level_that_a_source_names_is_one_of_the_three() -> None:
    given = [level for path in SOURCES if path.suffix == ".py" for level in levels_given(path)]
    assert set(given) - {"", None} <= set(LEVELS)


def test_a_level_is_read_with_its_effort() -> None:
    assert [level_name(level) for level in LEVELS] == ["preview", "surrogate", "reference"]
    assert level_name("surrogate", "few paths") == "surrogate (few paths)"
    assert level_of(None) == "preview"
    assert {level_of(effort) for effort in EFFORTS} == {"surrogate"}


@pytest.mark.parametrize(
    ("stored", "known"),
    [
        ("preview", ("preview", None)),
        ("preview of few paths", ("surrogate", "few paths")),
        ("converged preview", ("surrogate", "converged")),
        ("surrogate", ("surrogate", None)),
        ("reference", ("reference", None)),
    ],
)
def test_designs_and_tables_of_before_are_read(
    stored: str, known: tuple[str, str | None], tmp_path: Path
) -> None:
    assert read_level(stored) == known
    scene = load_scene("digit")
    parts = dict.fromkeys(("score", "mean", "spread_sites", "spread_bends"), 1.0)
    rating = ScoreSettings(1.0, 1.0).rating("preview", parts, (0.0, 2.0))
    path = tmp_path / "design.json"
    save_design(path, baseline_design(scene), scene, rating)
    content = json.loads(path.read_text())
    del content["effort"]
    path.write_text(json.dumps(content | {"level": stored}))
    file = load_design_file(path)
    assert (file.level, file.effort) == known
    assert file.rating is not None
    assert (file.rating.level, file.rating.effort) == known

    light = np.ones((1, 1, 1, 1, 3))
    arrays = {"T": light, "phi": np.zeros(1), "exposure": np.ones(1), "lam": np.ones(1)}
    np.savez(tmp_path / "table.npz", **arrays, level=np.array(stored))
    table = load_table(tmp_path / "table.npz")
    assert (table.level, table.effort) == known
    table.save(tmp_path / "again.npz")
    again = load_table(tmp_path / "again.npz")
    assert (again.level, again.effort) == known


@pytest.mark.parametrize("wrong", [{"level": "converged preview"}, {"effort": "many paths"}])
def test_a_table_of_another_level_or_effort_is_refused(wrong: dict[str, str]) -> None:
    light = np.ones((1, 1, 1, 1, 3))
    with pytest.raises(TableError, match="allowed: "):
        TransportTable(light, light, np.zeros(1), 1.0, 1.0, **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "effort"),
    [
        ("digit", "converged"),
        ("digit-dome", "table"),
        ("finger20", "network"),
        ("finger24", "converged"),
        ("gelsight-flat", "table"),
        ("gelsight-mini", "table"),
    ],
)
def test_shipped_models_of_before_say_what_they_are(name: str, effort: str) -> None:
    checker = Checker.load(ROOT / "models" / name)
    assert (checker.level, checker.effort) == ("surrogate", effort)
    assert checker.photon_noise is None
    own = checker.metadata.own_errors
    assert own is not None
    assert own["name"] in (effort, level_name("surrogate", effort))
    for row in checker.metadata.held_out:
        assert row["level"] in LEVELS
        assert row["effort"] in (None, *EFFORTS)


def test_held_out_errors_are_of_a_level() -> None:
    rows = {
        (NOISE, None, "ridge"): (NOISE, "reference", None),
        ("preview", None, "ridge"): ("preview", "preview", None),
        ("preview, one factor", "converged", "ridge"): (
            "surrogate (converged), one factor", "surrogate", "converged",
        ),
        ("network", None, NONE): ("network", "surrogate", "network"),
        ("unseen bend", None, "ridge"): ("unseen bend", "surrogate", "ridge"),
        ("unseen bend", "converged", NONE): ("unseen bend", "surrogate", "converged"),
    }  # fmt: skip
    for (name, traced, kind), expected in rows.items():
        row = held_out_row({"name": name}, traced, kind)
        assert (row["name"], row["level"], row["effort"]) == expected
