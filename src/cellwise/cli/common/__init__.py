"""What the commands share: options, tables for people, JSON."""
