"""Records that hold something else are told of in the words of the house."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from optimize.records.run_record import read_record
from tests.wrong_values import FOREIGN, WRONG, Place, changed, places

VERIFIED: dict[str, Any] = {
    "design": {"score": 90.5, "interval": [88.0, 92.0]},
    "difference": {"value": 3.5, "interval": [1.0, 6.0]},
    "converged": True,
    "samples": 16384,
    "seeds": [1, 2],
}
"""Every key of the record of a verification that is read."""
PAGE: dict[str, Any] = {
    "scene": {"name": "finger20", "hash": "0" * 16},
    "level": "surrogate",
    "halfWidth": 0.8,
    "designs": {},
    "scores": {"start": 90.0},
}
"""What a page to play with begins with."""


def told(folder: Path, kind: str, content: dict[str, Any]) -> str:
    """Return what is said of a run whose record has some content."""
    text = json.dumps(content)
    path = folder / ("verified-0123456789ab.json" if kind == "verify" else "page.html")
    if kind == "play":
        text = f'<script type="application/json" id="page">{text}</script>'
    path.write_text(text)
    return read_record(kind, path).note


@pytest.mark.parametrize(("kind", "content"), [("verify", VERIFIED), ("play", PAGE)])
def test_no_wrong_value_is_told_in_words_of_the_library(
    tmp_path: Path, kind: str, content: dict[str, Any]
) -> None:
    assert "is damaged" not in told(tmp_path, kind, content)
    for place in places(content):
        notes = [told(tmp_path, kind, changed(content, place, value)) for value in WRONG]
        damaged = [note for note in notes if "is damaged (" in note]
        assert len(damaged) > 4, place
        for note in damaged:
            assert str(place[0]) in note
            assert not [words for words in FOREIGN if words in note], (place, note)


@pytest.mark.parametrize(
    ("place", "value", "note"),
    [
        (("design", "score"), "much", 'design.score = "much", allowed: a number'),
        (("design", "interval"), [1.0], "[1.0], allowed: a list of at least 2 items"),
        (("seeds", 1), 2.5, "seeds[1] = 2.5, allowed: a whole number"),
        (("converged",), 3, "converged = 3, allowed: true or false"),
        (("difference",), [], "difference = [], allowed: a table"),
    ],
)
def test_it_names_the_key_the_value_and_what_is_right(
    tmp_path: Path, place: Place, value: object, note: str
) -> None:
    assert note in told(tmp_path, "verify", changed(VERIFIED, place, value))


@pytest.mark.parametrize(("content", "note"), [(b"", "it is empty"), (b"{", "it is not JSON")])
def test_a_record_that_holds_nothing_is_told_so(tmp_path: Path, content: bytes, note: str) -> None:
    path = tmp_path / "verified-0123456789ab.json"
    path.write_bytes(content)
    assert note in read_record("verify", path).note
