"""Methods of the two papers that cellwise starts from, on the same records as its own."""
