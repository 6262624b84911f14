"""What the lists of commands say about each command fits on its line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

Run = Callable[..., Any]


@pytest.mark.parametrize("group", [(), ("hw",)])
def test_no_sentence_of_a_list_of_commands_is_cut_at_80_columns(
    tactilux: Run, monkeypatch: pytest.MonkeyPatch, group: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = tactilux(*group, "--help")
    assert said.code == 0
    commands = said.out.partition("Commands:")[2].splitlines()
    assert len(commands) > 5
    assert not [line for line in commands if line.endswith("...")]
