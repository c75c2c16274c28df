"""Studies on embedded data."""
