"""Manufacturing tolerances and shadows: sensitivity, robust ratings, designs made for them."""

from optimize.robust.material_slopes import declared_tolerances, material_slopes
from optimize.robust.robustness_study import (
    RobustnessStudy,
    print_sensitivities,
    print_study,
    study_robustness,
)
from optimize.robust.sensitivity import check_slopes, score_slopes, sensitivities
