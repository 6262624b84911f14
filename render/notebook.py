"""What notebooks show of an object: a line, and under it a picture or a table, as HTML."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape

WIDTH = 560
"""Largest width of a picture, CSS pixels."""


def captioned(line: str, svg: str) -> str:
    """Return a line over a drawing; as an image of its own its style reaches nothing else."""
    picture = b64encode(svg.encode()).decode()
    return (
        f'<div>{escape(line)}</div><img alt="{escape(line)}" style="max-width:{WIDTH}px" '
        f'src="data:image/svg+xml;base64,{picture}">'
    )


def tabled(line: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a line over a table; headings and cells are text."""
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows
    )
    return (
        f"<div>{escape(line)}</div><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )
