"""The quick job: a better design, searched and rated on the surrogate."""

from optimize.exploration.exploration import (
    Exploration,
    Stage,
    explore,
    rate,
    rating_to_json,
)
