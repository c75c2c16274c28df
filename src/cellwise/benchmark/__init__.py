"""Studies on embedded data, and later scenarios and sensor faults."""
