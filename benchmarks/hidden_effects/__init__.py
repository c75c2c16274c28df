"""Effects hidden in emulated and measured logs: which are found, and from what size on."""
