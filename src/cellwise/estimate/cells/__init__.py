"""Cells of a pack in the fixed step: the mean cell by the filter, every cell by its difference."""
