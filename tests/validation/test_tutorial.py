"""The parts of the tutorial that take minutes even with little effort."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.docs.test_tutorial import PAGE, load_runner


def test_a_model_is_trained_for_the_own_sensor_and_found_by_its_hash(tmp_path: Path) -> None:
    runner = load_runner()
    blocks = list(runner.blocks(PAGE.read_text(encoding="utf-8")))
    first = next(i for i, block in enumerate(blocks) if "tactilux new" in block.body)
    (long,) = [block for block in blocks if block.long]
    with runner.Shell(tmp_path, small=True) as shell:
        for block in (*blocks[first : first + 2], long):
            shell.run(block)
        (by_hand,) = [block for block in blocks if "by-hand.toml" in block.body]
        asked = replace(by_hand, body=by_hand.body.replace(" --coarse", ""))
        said = shell.run(asked)
        assert ", surrogate (" in said
        assert "There is no model" not in said
    assert (tmp_path / "models" / "fingertip" / "checker.onnx").is_file()
