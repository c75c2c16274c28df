"""Accuracy on measured cells, on logs that no identification has seen."""
