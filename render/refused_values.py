"""What is told of a value that a file may not have: the value as the file writes it, what may be.

pydantic finds what is wrong; its own sentences ("Input should be a valid number") are for people
who write Python. Scene files, design files and records of runs are written by hand or damaged by
chance, and are told of in these words alone.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

TYPES = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number of at most 4300 digits",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "float_parsing": "a number",
    "int_parsing": "a whole number",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dataclass_type": "a table",
    "number_or_list": "a number, or a list of one per camera channel",
}
"""What stands where a value of another type is refused."""

BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
SHORT = 3
"""Letters of which a part of a name is not known by fewer."""
MAX_SHOWN = 80
"""Characters of a refused value that are shown: a whole table would hide the sentence."""


def allowed_words(problem: Any, keys: Sequence[str] = ()) -> str:
    """Return what may stand where a value is refused, "" where the problem itself says it.

    Arguments:
        problem: one entry of ``ValidationError.errors``.
        keys: those of a table, where one belongs.
    """
    kind, context = problem["type"], problem.get("ctx", {})
    if kind == "literal_error":
        words = str(context["expected"]).replace("'", '"').replace("True", "true")
        return words + did_you_mean(problem["input"], re.findall('"(.+?)"', words))
    if kind in {"too_short", "too_long"}:
        low = kind == "too_short"
        count = context["min_length" if low else "max_length"]
        items = "item" if count == 1 else "items"
        return f"a list of at {'least' if low else 'most'} {count} {items}"
    if kind == "string_too_short":
        return "a text that is not empty"
    words = TYPES.get(kind, "")
    if words == TYPES["model_type"] and keys:
        return f"{words} with {', '.join(keys)}"
    bounds = [f"{words} {context[key]:g}" for key, words in BOUNDS.items() if key in context]
    return words or " and ".join(bounds)


def did_you_mean(said: object, known: Iterable[str]) -> str:
    """Return which of the ``known`` names was meant, as the end of a sentence; "" where none is.

    >>> did_you_mean("gelsight_mini", ["digit", "gelsight-flat", "gelsight-mini"])
    ', did you mean gelsight-mini?'
    >>> did_you_mean("finger", ["digit", "finger20", "finger24"])
    ', did you mean finger20 or finger24?'
    """
    word = str(said).lower().replace("_", "-")
    plain = {name.lower().replace("_", "-"): name for name in known}
    parts = [name for name in plain if len(word) >= SHORT and word in name]
    near = parts if 1 <= len(parts) <= 2 else get_close_matches(word, plain, n=1)
    return f", did you mean {' or '.join(plain[name] for name in near)}?" if near else ""


def problem_sentence(problem: Any, patterns: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return what is wrong with one value of a JSON file, or of a TOML file in JSON's words.

    ``patterns`` says in words what the regular expressions of the file's texts allow.

    >>> problem_sentence({"type": "float_type", "loc": ("power", 3), "input": "1", "msg": "..."})
    'power[3] = "1", allowed: a number'
    """
    place, kind, value = value_place(problem), problem["type"], problem["input"]
    if kind == "json_invalid":
        error = problem["ctx"]["error"]
        return "it is empty" if not value else f"it is not JSON ({error})"
    if kind in {"extra_forbidden", "unexpected_keyword_argument"}:
        return f"unknown key {place}"
    if kind in {"missing", "missing_argument"}:
        return f"missing {'entry' if isinstance(problem['loc'][-1], int) else 'key'} {place}"
    allowed = allowed_words(problem)
    if kind == "string_pattern_mismatch":
        allowed = patterns[problem["ctx"]["pattern"]]
    if allowed:
        return f"{place or 'all of it'} = {in_json(value)}, allowed: {allowed}"
    message = str(problem["msg"].removeprefix("Value error, "))
    return f"{place} = {in_json(value)}: {message}" if kind != "value_error" else message


def value_place(problem: Any) -> str:
    """Return where in a file a problem is: ``power[3][1]``; "" for the file as a whole."""
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in problem["loc"]]
    return "".join(parts).removeprefix(".")


def in_json(value: Any) -> str:
    """Return a value as a JSON file has it, cut where it is long.

    >>> in_json({"x": [1, True, None]})
    '{"x": [1, true, null]}'
    """
    return _shown(json.dumps(value, ensure_ascii=False, default=str))


def in_toml(value: Any) -> str:
    """Return a value as a TOML file has it, cut where it is long.

    >>> in_toml({"value": ["four", True], "unit": "mm"})
    '{ value = ["four", true], unit = "mm" }'
    """
    return _shown(_toml(value))


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        entries = [f"{name} = {_toml(entry)}" for name, entry in value.items()]
        return f"{{ {', '.join(entries)} }}" if entries else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def _shown(text: str) -> str:
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 1]}…"
