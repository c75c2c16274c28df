"""Sections of the page of a replay: SOC, figures, remaining time and energy."""
