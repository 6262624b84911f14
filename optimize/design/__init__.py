"""A lighting design: what it is, what may be chosen, how good it is, and its file."""

from optimize.design.design import (
    DARK,
    Array,
    Colors,
    Design,
    ScoredDesign,
    baseline_design,
    one_led,
)
from optimize.design.design_file import (
    as_design,
    load_design,
    load_design_file,
    open_rated,
    palette_in_file,
    save_design,
)
from optimize.design.find_scene import RUN_MODEL, SCENE, find_scene, keep_scene, kept_name
from optimize.design.layout_file import load_layout
from optimize.design.limits import (
    SearchLimits,
    dimmed_baseline,
    limits_of,
    turning_limits,
    unlimited,
)
from optimize.design.linear_rules import Budget, LinearRules, exclusive_groups
from optimize.design.part_limits import (
    FULL_MILLIAMPERES,
    currents,
    part_entries,
    prices,
    searched_parts,
)
from optimize.design.rating import (
    CLIPPED,
    PARTS,
    RatedDesign,
    Rating,
    ReadErrors,
    ScoreSettings,
    design_digest,
    level_name,
    noise_words,
)
