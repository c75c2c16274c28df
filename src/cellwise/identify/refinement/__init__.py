"""Tables fitted to whole logs."""
