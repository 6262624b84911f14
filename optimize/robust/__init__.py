"""Manufacturing tolerances and shadows: sensitivity, robust ratings, designs made for them."""
