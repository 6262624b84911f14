"""Values of wrong types at every place of a file, and words that no refusal may have."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

WRONG: tuple[Any, ...] = ("four", 3, 2.5, 10**30, True, [], ["x"], [1, True], {}, {"x": 1})
FOREIGN = ("Input should", "valid ", "Tuple", "tuple", "dictionary", "instance of", "None", "'")
"""What the library that reads files says, and values as Python writes them."""

Place = tuple[str | int, ...]


def places(content: Any, place: Place = ()) -> Iterator[Place]:
    """Yield the place of every value, table and list."""
    inside: Any = enumerate(content) if isinstance(content, list) else ()
    for key, part in content.items() if isinstance(content, dict) else inside:
        yield (*place, key)
        yield from places(part, (*place, key))


def changed(content: dict[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """Return the content with another value at one place."""
    content = copy.deepcopy(content)
    part: Any = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    return content
