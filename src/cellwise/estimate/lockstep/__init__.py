"""Many cells of one model, one EKF each, stepped side by side."""
