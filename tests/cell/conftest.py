"""Hypothesis: the first call of a kernel compiles it, which is no property of the example."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("compiled", deadline=None, derandomize=True)
settings.load_profile("compiled")
