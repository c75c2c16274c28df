"""Beyond a model's temperatures nothing is said of the cell's age."""

from __future__ import annotations

import pytest

from cellwise.diagnose.decision.odds import AGE, LAW, TEMPERATURE, Rarity


@pytest.mark.parametrize("same_age", [True, False])
def test_age_is_hidden_beyond_the_temperatures_alone(same_age):
    beyond, within = (Rarity(far, same_age) for far in (True, False))
    assert all(beyond.hides(name) for name in AGE)
    assert not any(beyond.hides(name) for name in (LAW, *TEMPERATURE, "current_gain", "time_skew"))
    assert not any(within.hides(name) for name in AGE)


@pytest.mark.slow
def test_a_cold_cell_is_not_called_aged(real_data):
    """Two 0 degC drives to empty, a 25 degC model: a loss of lithium of 8.5 % was named, with 1.0.

    C/20 gave 2.997 Ah in the weeks before; the EKF's SOC went from 0.6 to 6.7 % with it.
    """
    from benchmarks.real_findings import FINDINGS

    from cellwise.diagnose import diagnose

    cold = FINDINGS["p00"]
    found = diagnose(cold.model(), cold.logs(), cold.holdout(), soc0=cold.soc0)
    assert not {c.name for c in found.causes} & AGE
    assert found.verdict != "none"
    assert found.next_test
