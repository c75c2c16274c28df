"""Cost, agreement and endurance of the C99 twin."""
