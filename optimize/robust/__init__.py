"""Manufacturing tolerances and shadows: sensitivity, robust ratings, designs made for them."""

from optimize.robust.material_slopes import (
    MATERIALS,
    material_slopes,
    spread_words,
    tolerances_of,
    usual_tolerances_note,
)
from optimize.robust.robustness_study import (
    RobustnessStudy,
    print_sensitivities,
    print_study,
    study_robustness,
)
from optimize.robust.sensitivity import check_slopes, exact_slopes, sensitivities
