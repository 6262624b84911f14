"""What a model says about itself goes into its file and comes out again."""

from __future__ import annotations

from pathlib import Path

from surrogate.runtime import Checker
from surrogate.runtime.metadata import AXES, read_props

MODEL = Path(__file__).parents[3] / "models" / "finger20"


def test_the_order_of_axes_is_in_the_file() -> None:
    props = Checker.load(MODEL).metadata.to_props()
    assert "seen with the tip up" in props["axes"]
    assert read_props(props, "model").axes == AXES


def test_a_model_from_before_axes_were_told_has_the_same() -> None:
    props = Checker.load(MODEL).metadata.to_props()
    del props["axes"]
    assert read_props(props, "model").axes == AXES


def test_the_card_of_the_shipped_model_says_them() -> None:
    card = (MODEL / "checker.md").read_text(encoding="utf-8")
    assert all(f"- {name}: {text}\n" in card for name, text in AXES.items())
