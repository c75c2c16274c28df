"""Checks of a log against itself: sign, units, the tester's counter, oddities."""
