"""How pages of the whole repository become one site: MkDocs calls these functions.

Pages keep their paths, ``docs/`` included, so relative links between them need no rewriting; what
they link to that is no page (pictures, sources, a notebook) comes along as it is. Formulas become
MathML, which browsers show without a script.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from posixpath import normpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
ASSETS = ("docs/site/site.css", "docs/site/iframe-worker.js")
LINK = re.compile(r"\]\(([^)\s#]+)[^)]*\)|(?:src|href|srcset)=\"([^\"#]+)\"")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the pages of the navigation at their places in the repository, and what they need."""
    themes = [file for file in files if file.src_dir != config.docs_dir]
    pages = list(_pages(config.nav))
    wanted = dict.fromkeys([*pages, *ASSETS])
    for page in pages:
        text = (ROOT / page).read_text(encoding="utf-8")
        wanted |= dict.fromkeys(_linked(PurePosixPath(page).parent, text))
    mine = [File.generated(config, uri, abs_src_path=str(ROOT / uri)) for uri in wanted]
    return Files([*themes, *mine])


def on_page_content(content: str, **_: Any) -> str:
    """Return a page with its formulas as MathML."""

    def mathml(found: re.Match[str]) -> str:
        kind = "block" if found[2] == "[" else "inline"
        return convert(html.unescape(found[3]).strip(), display=kind)

    return FORMULA.sub(mathml, content)


def _pages(nav: Any) -> Iterator[str]:
    """Yield the files of a navigation in their order."""
    if isinstance(nav, str):
        yield nav
    else:
        for part in nav.values() if isinstance(nav, dict) else nav:
            yield from _pages(part)


def _linked(folder: PurePosixPath, text: str) -> Iterator[str]:
    """Yield the files of the repository that a page in ``folder`` links to and that are no page."""
    for groups in LINK.findall(text):
        target = normpath(str(folder / "".join(groups)))
        if not target.endswith(".md") and (ROOT / target).is_file():
            yield target
