"""Parameters of pulses: one interface for three methods, and all pulses of a test together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.papers.segments import SegmentOptions, fit_segments
from cellwise.identify.papers.swarm import SwarmOptions, fit_swarm
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.identify.pulse_fit.pulse_parameters import (
    PulseFit,
    PulseParameters,
    PulseTrend,
    TauBounds,
)
from cellwise.identify.pulse_fit.pulse_trend import local_trends
from cellwise.identify.pulse_fit.varpro import VarproOptions, fit_varpro

Method = Literal["varpro", "segments", "pso"]
TREND_TOLERANCE = 1e-3  # a trend too small to be felt is still the better model
Options = VarproOptions | SegmentOptions | SwarmOptions

__all__ = [
    "PulseFit",
    "PulseParameters",
    "SegmentOptions",
    "SwarmOptions",
    "TauBounds",
    "VarproOptions",
    "fit_pulse",
    "fit_pulses",
]

_OPTIONS: dict[str, type[Options]] = {
    "varpro": VarproOptions,
    "segments": SegmentOptions,
    "pso": SwarmOptions,
}


def fit_pulse(
    data: PulseData,
    method: Method = "varpro",
    options: Options | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> PulseFit:
    """Parameters of one pulse.

    Parameters
    ----------
    data : PulseData          see `cut_pulse`
    method : str              ``varpro``: least squares by variable projection (default);
                              ``segments``: closed formulas on three points; ``pso``: swarm
    options : VarproOptions, SegmentOptions or SwarmOptions       those of the method
    rng : numpy Generator     for ``pso``; by default one seeded with 0

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        unknown method, options of another method
    """
    if method not in _OPTIONS:
        raise InputError(
            f"method {method!r}", "'varpro', 'segments' or 'pso'", "Choose one of the three."
        )
    if options is not None and type(options) is not _OPTIONS[method]:
        raise InputError(
            f"{type(options).__name__} for method {method!r}",
            _OPTIONS[method].__name__,
            "Give the options of the method.",
        )
    if isinstance(options, SegmentOptions) or method == "segments":
        return fit_segments(data, options if isinstance(options, SegmentOptions) else None)
    if isinstance(options, SwarmOptions) or method == "pso":
        chosen = options if isinstance(options, SwarmOptions) else None
        return fit_swarm(data, chosen, rng or np.random.default_rng(0))
    return fit_varpro(data, options)


def fit_pulses(
    pulses: Sequence[PulseData],
    method: Method = "varpro",
    options: Options | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> list[PulseFit]:
    """Parameters of all pulses of a test.

    With ``varpro`` in two passes: each pulse by itself; then again, with the change of the
    parameters over SOC taken from its neighbours (see `local_trends`). A strong pulse near empty
    moves every parameter by some percent, which is the error without the second pass.

    Parameters
    ----------
    pulses : sequence of PulseData        of one cell at one temperature
    method, options, rng                  as in `fit_pulse`

    Returns
    -------
    list of PulseFit          in the order given

    Raises
    ------
    InputError        as `fit_pulse`
    """
    rng = rng or np.random.default_rng(0)
    fits = [fit_pulse(data, method, options, rng=rng) for data in pulses]
    if method != "varpro":
        return fits
    chosen = options if isinstance(options, VarproOptions) else None
    trends = local_trends(fits)
    return [
        fit if trend is None else _with_trend(data, fit, chosen, trend)
        for data, fit, trend in zip(pulses, fits, trends, strict=True)
    ]


def _with_trend(
    data: PulseData, alone: PulseFit, options: VarproOptions | None, trend: PulseTrend
) -> PulseFit:
    """The pulse fitted with its neighbours' trend, unless it fits worse than alone.

    On a real cell a trend between levels need not hold inside a pulse.
    """
    second = fit_varpro(data, options, trend, (alone.tau1_s, alone.tau2_s))
    if second.rmse_V > (1.0 + TREND_TOLERANCE) * alone.rmse_V:
        return alone
    # What a search over the whole plane said of the errors holds here, too.
    return replace(second, error=PulseParameters(*np.maximum(second.error, alone.error).tolist()))
