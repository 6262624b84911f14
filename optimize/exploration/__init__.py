"""The quick job: a better design, searched and rated on its model."""

from optimize.exploration.exploration import (
    Exploration,
    Stage,
    explore,
    rate,
    stage_to_json,
)
