"""Derivatives of the equations, from their text."""
