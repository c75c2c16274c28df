"""Capacity that is left, estimated on a target."""
