"""Fits of causes to logs: rows, noise, priors, least squares, likelihood."""
