"""Making a surrogate: reference data, regression, held-out evaluation."""
