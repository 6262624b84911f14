"""Searches over colors and directions."""

from optimize.search.alternating_search import (
    AlternatingResult,
    SearchStep,
    alternating_search,
)
from optimize.search.directions import (
    DirectionResult,
    optimize_directions,
    population,
    tied_groups,
)
from optimize.search.local_refinement import (
    NominalScore,
    Objective,
    WeightedSum,
    multi_start,
    refine_directions,
    refine_locally,
)

__all__ = [
    "AlternatingResult",
    "DirectionResult",
    "NominalScore",
    "Objective",
    "SearchStep",
    "WeightedSum",
    "alternating_search",
    "multi_start",
    "optimize_directions",
    "population",
    "refine_directions",
    "refine_locally",
    "tied_groups",
]
