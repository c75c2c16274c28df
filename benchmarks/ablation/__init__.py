"""What each mechanism of a filter is worth: switched off by name, on a panel of measured logs."""
