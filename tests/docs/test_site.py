"""`make docs` builds a site without a broken link, which works from a folder without a network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import tactilux
from hw.cli import app

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site; strict: a link or an anchor that leads nowhere fails the build."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def tracked(pattern: str) -> set[str]:
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", pattern]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return set(listed.stdout.split())


def test_every_page_of_the_repository_is_in_the_site(site: Path) -> None:
    for page in tracked("*.md"):
        built = re.sub(r"README$", "index", page.removesuffix(".md")) + ".html"
        assert (site / built).is_file(), page


def test_the_api_page_has_every_public_name_with_what_its_docstring_says(site: Path) -> None:
    page = (site / "docs" / "api.html").read_text(encoding="utf-8")
    homes = set(re.findall(r'<h3 id="([\w.]+)"', page))
    for name in tactilux.__all__:
        assert f"tactilux.{name}" in homes, name
        first = (getattr(tactilux, name).__doc__ or "").split("\n")[0]
        words = re.sub(r"[`(].*", "", first).strip()
        assert words, name
        assert words[:40] in page, name


def test_every_command_is_on_the_page_of_commands() -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    names = {command.name for command in app.registered_commands}
    assert {"explore", "play", "runs"} < names
    first = "".join(row.split(" | ")[0] + "\n" for row in page.splitlines())
    assert [name for name in sorted(names) if not re.search(rf"`[^`]*\b{name}\b", first)] == []


def test_links_of_pages_lead_to_files_of_the_site(site: Path) -> None:
    pages = [page for page in site.rglob("*.html") if page.name != "404.html"]
    assert len(pages) > 10
    for page in pages:
        text = page.read_text(encoding="utf-8")
        targets = re.findall(r'(?:href|src)="([^"#?]+)', text)
        for target in targets:
            if not re.match(r"\w+:", target):
                assert (page.parent / target).is_file(), f"{page}: {target}"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_open_from_a_folder_and_ask_nobody_for_anything(
    site: Path, chromium: Browser, scheme: str
) -> None:
    with chromium.new_context(color_scheme=scheme, offline=True) as context:
        page = context.new_page()
        requests: list[str] = []
        complaints: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        # What the next page interrupts is no failure.
        page.on(
            "requestfailed",
            lambda request: (
                complaints.append(f"{request.url} {request.failure}")
                if request.failure != "net::ERR_ABORTED"
                else None
            ),
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        for path in sorted(site.rglob("*.html")):
            if path.name != "404.html":
                page.goto(path.as_uri())
                broken = page.evaluate(
                    "[...document.images].filter(i => i.complete && !i.naturalWidth).length"
                )
                assert broken == 0, path
    outside = [url for url in requests if not url.startswith((site.as_uri(), "data:", "blob:"))]
    assert outside == []
    assert complaints == []


def test_the_search_finds_a_word_without_a_server(site: Path, chromium: Browser) -> None:
    with chromium.new_context(offline=True) as context:
        page = context.new_page()
        page.goto((site / "index.html").as_uri())
        page.click(".md-search__input")
        page.keyboard.type("diffuser", delay=20)
        page.wait_for_selector(".md-search-result__item", timeout=20_000)
        found = page.locator(".md-search-result__link").first.get_attribute("href")
    assert found is not None
    assert (
        site / Path(found.split("?")[0].split("#")[0].removeprefix(site.as_uri() + "/"))
    ).is_file()


def test_formulas_are_mathml_and_none_is_left_as_source(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert "arithmatex" not in page.read_text(encoding="utf-8"), page


def test_names_that_a_page_links_to_a_source_are_in_it() -> None:
    found = 0
    for page in sorted((ROOT / "docs").glob("*.md")):
        for label, target in re.findall(r"\[([^\]]+)\]\(([^)]+\.(?:py|glsl))\)", page.read_text()):
            source = (page.parent / target).read_text(encoding="utf-8")
            for name in re.findall(r"`(\w+)`", label):
                assert name in source, f"{page.name}: {name} in {target}"
                found += 1
    assert found > 30
