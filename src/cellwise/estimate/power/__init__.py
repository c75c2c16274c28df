"""State of power: what a cell can give and take for some seconds within its limits."""
