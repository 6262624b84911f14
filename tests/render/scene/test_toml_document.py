"""A scene's content becomes a TOML text that is read back as it was, with its sources."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from render.files import parse_toml
from render.scene import load_scene, rewritten, save_scene, shipped_scenes, sources
from render.scene.scene_file import written_of
from render.scene.schema.toml_document import content_text

TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), max_size=20)
VALUES: Any = st.recursive(
    st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize("name", shipped_scenes())
def test_a_shipped_scene_is_read_back_as_it_was(name: str) -> None:
    scene = load_scene(name)
    content = written_of(scene).content
    assert parse_toml(content_text(content, "two\nlines")) == content
    again = rewritten(scene, "a comment")
    assert again.hash == scene.hash
    assert sources(again) == sources(scene)


@given(st.dictionaries(TEXTS, VALUES, max_size=5))
def test_any_content_is_read_back_as_it_was(content: dict[str, Any]) -> None:
    assert parse_toml(content_text(content)) == content


def test_a_changed_scene_is_kept_with_the_files_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "led.csv").write_text("angle,intensity\n0,1\n30,0.5\n60,0.1\n90,0\n")
    text = content_text(written_of(load_scene("digit")).content)
    source = tmp_path / "mine.toml"
    profile = '{ file = "led.csv", source = "measured" }'
    source.write_text(text.replace('"lambertian"', profile))
    changed = rewritten(load_scene(source).with_(pad_thickness=5.0), "thinner", name="thin")
    target = tmp_path / "elsewhere" / "thin.toml"
    save_scene(target, changed)
    again = load_scene(target)
    assert (again.hash, again.name, again.pad.thickness) == (changed.hash, "thin", 5.0)
    assert target.read_text().startswith("# thinner\n")
    assert (target.parent / "led.csv").is_file()
