"""The model's equations printed as code and formulas; needed by developers, not by users.

``python -m cellwise.printing`` prints everything again, ``--check`` says what differs.
"""
