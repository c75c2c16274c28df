"""Open-circuit voltage: from rests, from low-rate branches, from both."""
