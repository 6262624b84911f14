"""Designs by renders: verification, the loop in which renders decide, the thesis procedure."""

from optimize.verification.design_proposals import Proposal
from optimize.verification.design_renders import (
    DesignRenders,
    RenderDesigns,
    distinct_directions,
    pooled_renders,
    reference_renders,
)
from optimize.verification.design_verification import (
    Verification,
    verification_within,
    verify,
)
from optimize.verification.finalists import FinalistEvaluation
from optimize.verification.judges import Judge, judge_of
from optimize.verification.optimization import (
    Optimization,
    OptimizationMethod,
    OptimizeConfig,
    optimization_to_json,
    optimize,
)
from optimize.verification.score_allocation import allocation_of, score_allocation
from optimize.verification.thesis import thesis_on_table
from optimize.verification.timed_renders import TimedRenders
from optimize.verification.verification_loop import (
    CONVERGED,
    Candidate,
    LoopConfig,
    LoopRound,
    RenderedRound,
    SceneRefit,
    VerificationLoop,
)
