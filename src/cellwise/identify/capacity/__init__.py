"""Capacity tests, their table, and which capacity defines SOC."""
