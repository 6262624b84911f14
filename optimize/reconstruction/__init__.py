"""What a design's score is worth in degrees of surface normal."""

from optimize.reconstruction.normal_reconstruction import (
    SEEDS,
    CameraNoise,
    ErrorComparison,
    compare_reconstruction,
    guessing_error,
    normal_error,
    predicted_colors,
)
