"""Settings that all tests share."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest_plugins = ["tests.passed"]

# Two busy cores make any deadline a lottery, and a red build must be reproducible.
settings.register_profile("tactilux", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("tactilux")


@pytest.fixture(scope="session")
def mono() -> ModuleType:
    """Return Mitsuba in the mono variant that the reference renderer uses."""
    from render.reference import mitsuba

    return mitsuba("llvm_ad_mono")


@pytest.fixture
def variant_kept() -> Iterator[None]:
    """Leave the variant of Mitsuba that was set before the test: `mono` is set once a session."""
    mi = pytest.importorskip("mitsuba")
    before = mi.variant()
    yield
    if before is not None:
        mi.set_variant(before)


# Fixtures of a session that take many seconds, and the files that need them: on one worker.
# (``--dist loadgroup`` would say this with marks, but pytest-xdist 3.8 ignores the groups under
# pytest 9.2: https://github.com/pytest-dev/pytest-xdist/issues/1386.)
TOGETHER = {
    "trained": tuple(
        f"tests/surrogate/{name}.py"
        for name in (
            "runtime/test_checker",
            "runtime/test_ranking",
            "export/test_onnx",
            "model/test_materials",
            "export/test_package",
            "test_train",
        )
    ),
    "small_model": tuple(
        f"tests/optimize/cli/test_{name}.py"
        for name in (
            "bad_input",
            "compare",
            "explore",
            "faults",
            "optimize",
            "runs",
            "score",
            "sensitivity",
            "verify",
        )
    )
    + ("tests/validation/test_faults.py", "tests/hw/calibration/test_calibrated_scene.py"),
    "tiny_night": (
        "tests/optimize/overnight/test_whole_night.py",
        "tests/optimize/overnight/test_status.py",
        "tests/optimize/overnight/test_more_hours.py",
        "tests/optimize/overnight/test_follow.py",
    ),
    "night_report": (
        "tests/optimize/overnight/test_report.py",
        "tests/optimize/test_reports_in_a_browser.py",
    ),
}
# What takes longest of all begins first, so that no worker is left alone with it at the end.
LONGEST = (
    "tiny_night",
    "trained",
    "small_model",
    "tests/docs/test_tutorial.py",
    "tests/optimize/overnight/test_dask_workers.py",
    "tests/optimize/overnight/test_disk.py",
)


def share(nodeid: str) -> str:
    """Return the part of the tests that one worker runs: a file, or the files of a fixture."""
    file = nodeid.split("::", 1)[0]
    return next((name for name, files in TOGETHER.items() if file in files), file)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Let ``--dist loadfile`` know what goes together, and keep the order of the collection."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Shares(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return share(nodeid)

    config.option.loadscopereorder = False
    return Shares(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put what takes longest first on workers; refuse a costly fixture where nobody knows of it."""
    for item in items:
        for name in set(TOGETHER) & set(getattr(item, "fixturenames", ())):
            if share(item.nodeid) != name:
                raise pytest.UsageError(f"{item.nodeid} needs {name}: add its file to TOGETHER")
    if hasattr(config, "workerinput"):
        places = {name: place for place, name in enumerate(LONGEST)}
        items.sort(key=lambda item: places.get(share(item.nodeid), len(LONGEST)))


@dataclass(frozen=True)
class Result:
    """What a command did."""

    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture
def tactilux(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> Run:
    """Run the program in an empty directory and return exit code, stdout and stderr."""
    from hw.cli import main

    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["tactilux", *map(str, arguments)])
        capfd.readouterr()
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        said = capfd.readouterr()
        return Result(code, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """Return a running browser: the system's, or the one that Playwright has downloaded."""
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as playwright:
        names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
        found = [path for name in names if (path := shutil.which(name))]
        problems = []
        for path in [*found, None]:
            try:
                browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
            except Error as error:
                problems.append(str(error))
            else:
                yield browser
                browser.close()
                return
        pytest.fail("no Chromium: sudo apt-get install chromium\n" + "\n".join(problems))
