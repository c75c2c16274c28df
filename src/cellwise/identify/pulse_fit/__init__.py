"""Parameters of one pulse: varpro, segments, swarm."""
