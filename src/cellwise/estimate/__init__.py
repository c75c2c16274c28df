"""Estimation online: sample in, state and info out."""
