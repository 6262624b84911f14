"""What docs/api.md says of the public API: its study runs, in silence, by public names alone."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tactilux

PAGE = Path(__file__).parents[2] / "docs" / "api.md"


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_the_study_of_variants_runs_and_prints_its_results_alone() -> None:
    study = next(block for block in blocks() if "with_(" in block)
    assert re.findall(r"^(?:import|from) .*$", study, re.MULTILINE) == ["import tactilux"]
    done = subprocess.run([sys.executable, "-c", study], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    assert all(re.fullmatch(r"[45] mm: score \d+, normals \d+\.\d deg", line) for line in lines)
    assert lines[0][6:] != lines[1][6:]


def test_every_public_name_is_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in tactilux.__all__ if f"::: tactilux.{name}\n" not in text + "\n"] == []


def test_results_are_one_line_at_the_prompt_and_html_in_a_notebook() -> None:
    scene = tactilux.load_scene("finger20")
    model, design = tactilux.load_model(scene), tactilux.baseline_design(scene)
    table = model.transport_table(np.array([0.5, 2.0]))
    with tactilux.Preview(scene) as preview:
        shown = [scene, model, design, table, preview, tactilux.rate(design, scene, model=model)]
        for one in shown:
            assert re.fullmatch(r"<[A-Z][^\n]{10,300}>", repr(one)), repr(one)
    for one in (scene, model, design):
        assert re.search(r"<(img|table)", one._repr_html_()), repr(one)
    assert design._repr_html_().count("<tr>") == 21


@pytest.mark.slow
def test_a_search_is_one_line_and_a_table_and_says_its_steps_when_asked_alone(
    capfd: pytest.CaptureFixture[str],
) -> None:
    found = tactilux.explore("digit")
    assert capfd.readouterr() == ("", "")
    assert re.fullmatch(r"<Exploration of digit: score \d+\.\d -> [^\n]+>", repr(found))
    assert "<table>" in found._repr_html_()
    tactilux.explore("digit", progress=True)
    assert "score" in capfd.readouterr().err


@pytest.mark.slow
def test_a_picture_is_what_the_camera_records_and_normals_are_recovered() -> None:
    design = tactilux.baseline_design("digit")
    seen = tactilux.picture(design, "digit", size=(24, 32))
    assert seen.shape == (32, 24, 3)
    assert 0.0 <= seen.min() < seen.max() <= 255.0
    errors = tactilux.reconstruct(design, "digit")
    assert errors["lookup_mean"].difference == 0.0
    assert 0.0 < errors["lookup_mean"].design < 30.0
