"""Models of one cell at several temperatures put together as one with a temperature axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellwise.cell.effects import Effect, Hysteresis, SlowDiffusion, TimeSkew
from cellwise.cell.model import TABLES, CellModel, ModelTables
from cellwise.cell.model_error import SCALES_S, ModelError
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
    """The errors of several models, each at its own temperature; shares as root mean squares."""
    same = {e.scales_s for e in errors}
    scales = errors[0].scales_s if len(same) == 1 else SCALES_S
    moved = [e.on_scales(scales) for e in errors]
    points = max(len(e.std_V[0][0]) for e in moved)
    grid = np.linspace(0.0, 1.0, points)

    def rms(values: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
        return tuple(float(v) for v in np.sqrt(np.mean(np.square(values), axis=0)))

    reach = [e.correlation_soc for e in errors]
    return ModelError(
        scales_s=scales,
        std_V=tuple(
            tuple(tuple(float(v) for v in np.sqrt(e.variance_V2(k, grid))) for e in moved)
            for k in range(len(scales))
        ),
        temperature_C=tuple(float(t) for t in temperature_C),
        share=rms([e.shares() for e in moved]),
        charge_share=rms([e.shares(-1.0) for e in moved]),
        persistent_share=max(e.persistent_share for e in errors),
        correlation_soc=None if None in reach else rms([(r or 0.0,) for r in reach])[0],
        unseen_share=max(e.hidden_share() for e in errors),
        unseen_charge_share=max(e.hidden_share(-1.0) for e in errors),
    )


def _rows(models: Sequence[CellModel], values: Sequence[FloatArray | float]) -> FloatArray:
    return np.vstack(
        [np.broadcast_to(v, m.ocv_V.shape) for v, m in zip(values, models, strict=True)]
    )
