"""What docs/scenes.md shows of parts is taken as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

from optimize.design import limits_of
from optimize.placement import searched_scene
from render.scene import load_scene, scene_text

PAGE = Path(__file__).parents[2] / "docs" / "scenes.md"


def test_the_section_of_parts_is_taken(tmp_path: Path) -> None:
    (section,) = re.findall(r"```toml\n(\[\[parts\]\].*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "mine.toml").write_text(scene_text("digit") + section)
    scene = searched_scene(load_scene(tmp_path / "mine.toml"))
    limits = limits_of(scene)
    keys = {budget.key for budget in limits.budgets}
    assert keys == {"search.counts.0", "search.current", "search.price"}
    assert limits.most_lit == 6
    assert limits.allowed[:, scene.palette.index("mine")].sum() == 34
