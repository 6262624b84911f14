"""The three levels of the fidelity ladder, and the effort that a surrogate states.

>>> level_name("surrogate", "few paths"), level_name("preview")
('surrogate (few paths)', 'preview')
"""

from __future__ import annotations

from typing import Any, Final, Literal, get_args

Level = Literal["preview", "surrogate", "reference"]
LEVELS: tuple[Level, ...] = get_args(Level)
PREVIEW: Final = "preview"
"""What the shader draws, as drawn."""
SURROGATE: Final = "surrogate"
"""The preview corrected: by traced light, or by what renders teach."""
REFERENCE: Final = "reference"
"""What Mitsuba renders."""

Effort = Literal["few paths", "converged", "few renders", "ridge", "network", "table"]
EFFORTS: tuple[Effort, ...] = get_args(Effort)
FEW_PATHS: Final = "few paths"
"""Traced light of few paths: seconds."""
CONVERGED: Final = "converged"
"""Traced light of converged paths: one to three minutes."""
FEW_RENDERS: Final = "few renders"
"""Whatever renders of some minutes bear out."""
RIDGE: Final = "ridge"
NETWORK: Final = "network"
TABLE: Final = "table"
"""The renders themselves, as there is nothing between the nodes."""

EARLIER: dict[str, tuple[Level, Effort]] = {
    "preview of few paths": (SURROGATE, FEW_PATHS),
    "converged preview": (SURROGATE, CONVERGED),
}
"""What files of earlier versions have for a level."""


def read_level(level: Any, effort: Any = None) -> tuple[Level, Effort | None]:
    """Return level and effort of a file, whichever version wrote it; both are still unchecked."""
    return EARLIER.get(level, (level, effort))


def level_of(effort: str | None) -> Level:
    """Return the level of what corrects the preview with ``effort``; None is the preview alone."""
    return PREVIEW if effort is None else SURROGATE


def level_name(level: str, effort: str | None = None) -> str:
    """Return level and effort as people read them."""
    return level if effort is None else f"{level} ({effort})"
