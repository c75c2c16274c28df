"""Stock models: cells that others measured, to start from; by name wherever a model is read."""
