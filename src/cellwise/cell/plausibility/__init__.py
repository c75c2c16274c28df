"""Whether a log can be of a cell: refusals, and notices in the order of what they do."""
