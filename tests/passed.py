"""Long test runs that are stopped go on: ``pytest --passed FILE``, as in ``make validation-long``.

What passed or was skipped is written into the file at once, and left out of a run that names the
file again.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption("--passed", type=Path, help="Leave out tests in this file, add what passes.")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what has passed."""
    file = config.getoption("passed")
    if file is None or not file.is_file():
        return
    passed = set(file.read_text().splitlines())
    left_out = [item for item in items if item.nodeid in passed]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item.nodeid not in passed]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write down a test that passed with its fixtures' ends."""
    before = item.session.testsfailed
    done = yield
    file = item.config.getoption("passed")
    if file is not None and item.session.testsfailed == before:
        with file.open("a") as passed:
            passed.write(f"{item.nodeid}\n")
    return done


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Let a run in which nothing was left to do succeed."""
    nothing = exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED
    if nothing and session.config.getoption("passed") is not None:
        session.exitstatus = pytest.ExitCode.OK
