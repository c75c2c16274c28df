"""Speed of simulation, filters and identification, with references in the same run."""
