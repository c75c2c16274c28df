"""The model's equations printed as code and formulas; needed by developers, not by users."""
