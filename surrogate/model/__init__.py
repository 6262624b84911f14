"""The surrogate as torch modules: preview table, features, residual, metric."""
