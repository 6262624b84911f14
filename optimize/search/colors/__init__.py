"""Which LED drives which fiber: one file per search strategy."""

from optimize.search.colors.all_colorings import all_colorings
from optimize.search.colors.colorings import ColorResult, canonical, renamed_like
from optimize.search.colors.combinations import are_combinations, count_combinations
from optimize.search.colors.exact import exact_colors
from optimize.search.colors.grouped import grouped_colors
from optimize.search.colors.quick import quick_colors
