"""Reports: single HTML files with pictures, and what they are drawn with."""

from optimize.report.depth_report import depth_maps, print_depths, write_depths
from optimize.report.exploration_report import (
    BASELINE,
    DESIGN,
    PLAY,
    REPORT,
    degrees_row,
    doubted_gain,
    parts_moved,
    print_scores,
    render_report,
    score_row,
    warnings,
    write_exploration,
)
from optimize.report.illustrations import (
    STAGES,
    bolt_pictures,
    camera_pictures,
    convergence,
    design_pictures,
    drawing,
    encode_srgb,
    facet_strip,
    picture_png,
    png_bytes,
    site_map,
)
from optimize.report.optimization_report import TITLES, conclusions, doubts, write_optimization
from optimize.report.page import (
    building_steps,
    clipping_warning,
    data_uri,
    guessing_warning,
    holder_warning,
    monochrome_warning,
    preview_warnings,
    reader_verdict,
    render_page,
    sensor_figure,
    stage_pictures,
    template_text,
    verification_steps,
)
from optimize.report.wiring import wiring_context, wiring_drawing, wiring_files, write_wiring
