"""Text exports whose rows are not those of one plain table."""
