"""cellwise start: what lies in a folder, and what to do with it."""
