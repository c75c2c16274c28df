"""What is kept of a residual on a target, and how it is read."""
