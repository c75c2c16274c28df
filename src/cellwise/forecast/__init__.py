"""Remaining time and energy of a cell, at the present load or over a replayed log."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from cellwise.forecast.remaining import Flight, Forecast, forecast

__all__ = ["Flight", "Forecast", "forecast"]


class _CallableModule(ModuleType):
    """`cellwise.forecast` is this folder and, on the public face, the function of the same name."""

    def __call__(self, *args: Any, **kwargs: Any) -> Flight | None:
        return forecast(*args, **kwargs)


sys.modules[__name__].__class__ = _CallableModule
