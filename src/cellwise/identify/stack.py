"""Models of one cell at several temperatures put together as one with a temperature axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellwise.cell.effects import Effect, Hysteresis, SlowDiffusion, TimeSkew
from cellwise.cell.model import TABLES, CellModel, ModelError, ModelTables
from cellwise.typing import FloatArray


def stack_models(models: Sequence[CellModel]) -> CellModel:
    """One model over all temperatures; a single model is returned as it is.

    The Arrhenius factor of a single-temperature model gives way to the axis. An effect that only
    some have is neutral at the others. The error is the mean of squares.
    """
    if len(models) == 1:
        return models[0]
    ordered = sorted(models, key=lambda m: float(m.temperature_C[0]))
    tables = ModelTables(*(np.vstack([getattr(m, name) for m in ordered]) for name in TABLES))
    effects: list[Effect] = []
    if any(np.any(m.effect(SlowDiffusion).r3_ohm) for m in ordered):
        effects.append(
            SlowDiffusion(
                _rows(ordered, [m.effect(SlowDiffusion).r3_ohm for m in ordered]),
                _rows(ordered, [m.effect(SlowDiffusion).tau3_s for m in ordered]),
            )
        )
    if any(np.any(m.effect(Hysteresis).m_V) for m in ordered):
        gammas = [m.effect(Hysteresis).gamma for m in ordered if np.any(m.effect(Hysteresis).m_V)]
        effects.append(
            Hysteresis(
                _rows(ordered, [m.effect(Hysteresis).m_V for m in ordered]),
                float(np.exp(np.mean(np.log(gammas)))),
            )
        )
    skews = [m.effect(TimeSkew).skew_s for m in ordered if m.effect(TimeSkew).skew_s > 0]
    if skews:
        effects.append(TimeSkew(float(np.median(skews))))
    return replace(
        ordered[0],
        **tables._asdict(),
        temperature_C=np.array([float(m.temperature_C[0]) for m in ordered]),
        effects=tuple(effects),
        error=_mean_error([m.error for m in ordered], [m.temperature_C[0] for m in ordered]),
    )


def _mean_error(errors: Sequence[ModelError], temperature_C: Sequence[float]) -> ModelError:
    """Root mean square of the errors of several models, each at its own temperature."""

    def rms(values: Sequence[float] | FloatArray) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    points = max(len(e.slow_V) for e in errors)
    grid = np.linspace(0.0, 1.0, points)
    slow = np.sqrt(np.mean([e.at(grid) ** 2 for e in errors], axis=0))
    whole = rms(slow)
    own = [rms(e.at(grid)) / whole for e in errors] if whole > 0.0 else [1.0] * len(errors)
    reach = [e.correlation_soc for e in errors]
    return ModelError(
        white_V=rms([e.white_V for e in errors]),
        slow_V=tuple(float(v) for v in slow),
        correlation_s=rms([e.correlation_s for e in errors]),
        resistance_share=rms([e.share() for e in errors]),
        charge_share=rms([e.share(-1.0) for e in errors]),
        temperature_C=tuple(float(t) for t in temperature_C),
        temperature_factor=tuple(own),
        correlation_soc=None if None in reach else rms([r for r in reach if r is not None]),
    )


def _rows(models: Sequence[CellModel], values: Sequence[FloatArray | float]) -> FloatArray:
    return np.vstack(
        [np.broadcast_to(v, m.ocv_V.shape) for v, m in zip(values, models, strict=True)]
    )
