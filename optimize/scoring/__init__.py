"""Scores of designs, on transport tables and from renders, with derivatives and uncertainty."""

from optimize.scoring.confidence import (
    IntervalCheck,
    check_interval,
    normal_factor,
    prediction_checked,
    student_factor,
)
from optimize.scoring.jackknife import (
    JackknifeEstimate,
    jackknife,
    jackknife_parts,
    pooled_estimate,
)
from optimize.scoring.merit import Merit, MeritGradient, ScoreMerit
from optimize.scoring.noise_doubt import noise_doubt
from optimize.scoring.rank_agreement import RankAgreement, rank_agreement
from optimize.scoring.render_scores import RenderedScore, paired_difference, rendered_score
from optimize.scoring.score_noise import TIE_DRAWS, score_draws, score_interval, tied
from optimize.scoring.surrogate_model import (
    as_model,
    first_model,
    is_prompt,
    model_of_design,
    open_model,
    predict_design,
    predicted_colors,
    predicted_spread,
    scene_model,
    search_table,
    trained_model,
)
from optimize.scoring.table_scorer import TableScorer, improves
