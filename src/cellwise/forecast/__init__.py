"""Remaining time and energy of a cell, at the present load or over a replayed log."""
