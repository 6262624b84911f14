"""What a sensor is: the scene file, its quantities, constraints and tolerances."""
