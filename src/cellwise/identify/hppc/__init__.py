"""HPPC logs: edges, phases, pulses and their quality."""
