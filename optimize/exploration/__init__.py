"""The quick job: a better design, searched and rated on the surrogate."""

from optimize.exploration.exploration import (
    Exploration,
    Stage,
    explore,
    rate,
    stage_to_json,
)
