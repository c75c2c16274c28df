"""What one command does beyond one function: for a notebook and for the command alike."""
