"""Designs of one scene side by side: scores, differences with intervals, pictures."""

from optimize.comparison.comparison import (
    LETTERS,
    DesignComparison,
    DesignDifference,
    compare_by_renders,
    compare_on_model,
)
from optimize.comparison.comparison_page import (
    difference_rows,
    render_comparison,
    write_comparison,
)
from optimize.comparison.named_designs import NamedDesign, design_file, name_designs
