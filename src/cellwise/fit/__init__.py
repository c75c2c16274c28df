"""The one fit of a model to logs: unknowns, residual, likelihood, solution, posterior."""
