"""Printed sources: what follows from the description of the states, and the C of the fixed step.

``python -m cellwise.printing`` prints everything again, ``--check`` says what differs.
"""
