"""Capacity learnt on a target."""
