"""The page of a pack."""
