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
    refine_by,
    refine_locally,
)
from optimize.search.reader_objective import ReaderObjective, ReaderOptimum, search_by_reader
