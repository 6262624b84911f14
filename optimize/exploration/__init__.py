"""The quick job: a better design, searched and rated on the surrogate."""
