"""Variable projection of a pulse: search, kernels, standard errors."""
