"""What a design's score is worth in degrees of surface normal."""
