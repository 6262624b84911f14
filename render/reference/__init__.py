"""The reference: transport tables and pictures with error bars."""

from render.cells.choose_sampler import check_rendered
from render.reference.allocation import EVERYTHING, PRESSED, SampleAllocation
from render.reference.budget import TimeBudget, render_within, stored_plan
from render.reference.choose_samples import samples_of_full_pass, samples_per_pass
from render.reference.convergence import converged, doubt, more_effort, more_samples
from render.reference.cost import RenderCost, growing_cost, trial_cost
from render.reference.job import RenderJob, RenderResult, Sampler, pad_cells, run_job
from render.reference.llvm import VARIANT, ensure_llvm, mitsuba
from render.reference.picture import Picture, render_image, smoothed
from render.reference.transport import (
    JobRunner,
    TransportEstimate,
    render_transport,
    transport_estimate,
    transport_jobs,
)
