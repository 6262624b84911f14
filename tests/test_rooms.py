"""Packages import each other one way, and so do the rooms inside a package."""

from __future__ import annotations

import ast
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("render", "surrogate", "optimize", "hw")
"""Each knows those before it."""


def imports(package: str) -> dict[str, set[str]]:
    """Return what the modules of ``package`` import of our own, by module path."""
    found = defaultdict(set)
    for path in (ROOT / package).rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = {f"{node.module}.{name.name}" for name in node.names}
                found[module] |= {name for name in names if name.split(".")[0] in PACKAGES}
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_knows_only_those_below_it(package: str) -> None:
    allowed = PACKAGES[: PACKAGES.index(package) + 1]
    upward = {
        (module, name)
        for module, names in imports(package).items()
        for name in names
        if name.split(".")[0] not in allowed
    }
    assert not upward


@pytest.mark.parametrize("package", ["optimize", "hw"])
def test_rooms_of_a_package_import_each_other_without_a_circle(package: str) -> None:
    rooms = defaultdict(set)
    for module, names in imports(package).items():
        parts = module.split(".")
        if len(parts) == 2:  # a module beside the rooms
            continue
        for name in names:
            other = name.split(".")
            if (
                other[0] == package
                and (ROOT / package / other[1]).is_dir()
                and other[1] != parts[1]
            ):
                rooms[parts[1]].add(other[1])
    order = list(TopologicalSorter(rooms).static_order())  # raises CycleError, which names it
    assert set(rooms) <= set(order)
