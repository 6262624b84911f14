"""The quick job: a better design, searched and rated on the surrogate."""

from optimize.exploration.exploration import (
    PHI_NODES,
    Exploration,
    Stage,
    explore,
    rate,
)

__all__ = [
    "PHI_NODES",
    "Exploration",
    "Stage",
    "explore",
    "rate",
]
