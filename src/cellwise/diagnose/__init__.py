"""Diagnosis: where a simulation is wrong, the cause, and what an extended model gains."""

from __future__ import annotations

import sys
from inspect import signature
from types import ModuleType

from cellwise.diagnose.diagnosis import diagnose
from cellwise.diagnose.result import Diagnosis, FoundCause, TriedCause

__all__ = ["Diagnosis", "FoundCause", "TriedCause", "diagnose"]


class _CallableDiagnose(ModuleType):
    """`cellwise.diagnose` is this folder and, on the public face, the function of the same name."""

    __call__ = staticmethod(diagnose)
    __signature__ = signature(diagnose)  # for help and editors


sys.modules[__name__].__class__ = _CallableDiagnose
