"""Simulations whose start is found, as the command finds it."""
