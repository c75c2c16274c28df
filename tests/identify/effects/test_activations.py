"""Activations of single resistances."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.fit.rows import FitLog, inverse_K
from cellwise.fit.unknowns import FitSettings
from cellwise.identify.effect_selection import fit_with_effects
from fit_cases import Truth, cells_like, constant, joint_logs, log_of
from synthetic import drive_current

DRIVES_C = (0.0, 13.0, 25.0, 40.0)
REFERENCE_C = 25.0
SETTINGS = FitSettings(branches=2)
COMMON_K = 2500.0
OWN_K = {"r0": 1000.0, "r1": 4500.0, "r2": 2500.0}


def factor(activation_K: float, temperature_C: float) -> float:
    return float(np.exp(activation_K * inverse_K(temperature_C, REFERENCE_C)))


def truth_at(temperature_C: float, r0_K: float, r1_K: float, r2_K: float) -> Truth:
    """A cell of one temperature, each resistance with its own activation."""
    r0, r1, r2 = (factor(e, temperature_C) for e in (r0_K, r1_K, r2_K))
    return Truth(
        r0=constant(0.025 * r0),
        pairs=((constant(0.012 * r1), constant(6.0)), (constant(0.020 * r2), constant(90.0))),
    )


def drives(truths: dict[float, Truth]) -> list[FitLog]:
    rng = np.random.default_rng(4)
    found = []
    for k, (warm, truth) in enumerate(truths.items()):
        current = drive_current(2000, 1.0, 9.0, np.random.default_rng(k))
        log, _ = log_of(
            current, truth, noise=5e-4, rng=rng, temperature_C=np.full(current.size, warm)
        )
        found.append(FitLog(log, 1.0, skewed=True, temperature_C=REFERENCE_C))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("own", [True, False])
def test_each_resistance_gets_its_own_activation_only_where_drives_held_out_show_it(own):
    wanted = OWN_K if own else dict.fromkeys(OWN_K, COMMON_K)
    logs = drives({t: truth_at(t, *wanted.values()) for t in DRIVES_C})
    found = fit_with_effects(joint_logs(logs, cells_like(1.2), SETTINGS))
    verdict = next(d for d in found.decided if d.name == "temperature_dependence")
    assert verdict.accepted == own
    thermal = found.result.temperature_dependence()
    beside = {name: getattr(thermal, f"{name}_K") for name in OWN_K}
    if own:
        whole = {name: thermal.activation_K + value for name, value in beside.items()}
        assert whole == pytest.approx(OWN_K, abs=400.0)
    else:
        assert not any(beside.values())
