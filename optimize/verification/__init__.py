"""Designs at level 2: verification, the loop in which renders decide, the thesis procedure."""

from optimize.verification.design_proposals import Proposal
from optimize.verification.design_renders import (
    DesignRenders,
    FinalistEvaluation,
    RenderDesigns,
    distinct_directions,
    evaluate_finalists,
    reference_renders,
)
from optimize.verification.design_verification import Verification, affordable_samples, verify
from optimize.verification.optimization import (
    Optimization,
    OptimizationMethod,
    OptimizeConfig,
    optimization_to_json,
    optimize,
    write_optimization,
)
from optimize.verification.thesis import GENERATIONS
from optimize.verification.verification_loop import (
    CONVERGED,
    Candidate,
    LoopConfig,
    LoopRound,
    RenderedRound,
    VerificationLoop,
)

__all__ = [
    "CONVERGED",
    "GENERATIONS",
    "Candidate",
    "DesignRenders",
    "FinalistEvaluation",
    "LoopConfig",
    "LoopRound",
    "Optimization",
    "OptimizationMethod",
    "OptimizeConfig",
    "Proposal",
    "RenderDesigns",
    "RenderedRound",
    "Verification",
    "VerificationLoop",
    "affordable_samples",
    "distinct_directions",
    "evaluate_finalists",
    "optimization_to_json",
    "optimize",
    "reference_renders",
    "verify",
    "write_optimization",
]
