"""Criticism: what a simulation gets wrong, why, and what the model gains when it is mended."""

from cellwise.diagnose.diagnosis import diagnose
from cellwise.diagnose.verdict import Diagnosis, FoundCause, TriedCause

__all__ = ["Diagnosis", "FoundCause", "TriedCause", "diagnose"]
