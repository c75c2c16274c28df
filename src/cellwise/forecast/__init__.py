"""Remaining time and energy of a cell, at the present load or over a replayed log."""

from __future__ import annotations

import sys
from inspect import signature
from types import ModuleType

from cellwise.forecast.remaining import Forecast, ForecastTrace, forecast

__all__ = ["Forecast", "ForecastTrace", "forecast"]


class _CallableForecast(ModuleType):
    """`cellwise.forecast` is this folder and, on the public face, the function of the same name."""

    __call__ = staticmethod(forecast)
    __signature__ = signature(forecast)  # for help and editors


sys.modules[__name__].__class__ = _CallableForecast
