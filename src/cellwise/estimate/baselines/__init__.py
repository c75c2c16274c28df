"""The same filters written with filterpy: baselines for speed, oracles for correctness."""
