"""Packs: many cells on one model, each by its difference from the mean cell."""
