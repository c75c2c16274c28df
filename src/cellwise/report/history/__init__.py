"""The page of a life."""
