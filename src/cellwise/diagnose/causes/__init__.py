"""The causes of a model error, their coordinates, and how the voltage depends on them."""
