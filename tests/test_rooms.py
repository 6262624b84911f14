"""Packages and rooms import each other one way; names are unique; no room is too full."""

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


@pytest.mark.parametrize("package", PACKAGES)
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


def test_no_two_public_classes_share_a_name() -> None:
    homes = defaultdict(set)
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    homes[node.name].add(path.relative_to(ROOT).as_posix())
    assert not {name: places for name, places in homes.items() if len(places) > 1}


def test_no_room_holds_more_than_twenty_two_modules() -> None:
    rooms = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_dir()]
    assert not {str(room): n for room in rooms if (n := len(list(room.glob("*.py")))) > 22}


LINES = {
    "render": 33_467,  # LEDs of data sheets; shots; places; steady sums, traced light in parts
    "surrogate": 6_674,  # models state level and effort, of each held-out error too
    "optimize": 26_894,  # parts, counts, pairs of places; traced light refines; errors are drawn
    "hw": 10_630,  # a rig plays shots; sheets say the exposure; bands are found; one check of a rig
}
"""Lines of each package. They may fall; who raises one says beside it what for."""


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_does_not_grow_without_a_reason(package: str) -> None:
    lines = sum(
        len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / package).rglob("*.py")
    )
    assert lines <= LINES[package]
