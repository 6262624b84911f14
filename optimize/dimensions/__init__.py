"""What the numbers of a scene file are worth in degrees: how thick, how high, how much pigment."""

from optimize.dimensions.dimension import (
    Dimension,
    Variants,
    dimension,
    dimension_of,
    dimensions_of,
    numbers_of,
)
from optimize.dimensions.relative_change import RelativeChange, relative_change
from optimize.dimensions.stepped_search import stepped_search
from optimize.dimensions.study import Study, StudyRow, run_study
from optimize.dimensions.study_page import (
    PLAN,
    begin_study,
    print_study_table,
    study_figure,
    write_study,
)
