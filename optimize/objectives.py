"""What a design is improved for, by the names that users give: readers' degrees, or the score S."""

from typing import Literal, get_args

ReaderName = Literal["sensor", "place"]
READERS: tuple[ReaderName, ...] = get_args(ReaderName)
ObjectiveName = Literal[ReaderName, "score"]
OBJECTIVES: tuple[ObjectiveName, ...] = get_args(ObjectiveName)
ERROR_KEYS: dict[ReaderName, str] = {"sensor": "reader_error", "place": "normal_error"}
"""How programs know the readers' errors; the unit, ``_deg``, follows."""


def sign_of(objective: ObjectiveName) -> float:
    """Return 1 where more is better, -1 where less is: of a reader's error."""
    return 1.0 if objective == "score" else -1.0


def unit_of(objective: ObjectiveName) -> str:
    """Return the sign of the unit: none for counts of S, that of degrees for a reader."""
    return "" if objective == "score" else "°"


def title_of(objective: ObjectiveName) -> str:
    """Return what a figure is of.

    >>> title_of("sensor"), title_of("score")
    ('sensor reader', 'score S')
    """
    return "score S" if objective == "score" else f"{objective} reader"
