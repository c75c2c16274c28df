"""The page of a benchmark: overview, pictures, tables."""
