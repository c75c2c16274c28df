"""An extended model is the cell that the fit has seen, whatever effects the model had before."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.effects import ChargeTransfer, SurfaceSoc
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.validity import UNKNOWN, Validity
from cellwise.cell.simulate import simulate
from cellwise.diagnose import diagnose
from cellwise.diagnose.applied import extend_model
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
from estimator_cases import ACTIVE
from example_cells import curved_cell

SOC0 = 0.8
# Where the cell differs from its model, in what belongs to the cell.
AWAY = {
    "ln_capacity": 0.04, "ln_scale": 0.1, "ln_r0": -0.05, "ln_r1": 0.15, "ln_tau2": 0.1,
    "activation_K": 300.0, "rate_h": 0.02, "ln_charge_scale": 0.1, "leak_A": 0.01,
    "asinh_per_V": 15.0,
}  # fmt: skip
CASES = {**{name: (effect,) for name, effect in ACTIVE.items()}, "all": tuple(ACTIVE.values())}


def drive(seed, rows=1500):
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.uniform(-4.0, 6.0, rows // 15), 15)
    current[:30] = 0.0
    warm = 18.0 + 10.0 * np.sin(np.arange(rows) / 300.0)
    return CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), temperature_C=warm)


@pytest.mark.parametrize("effects", CASES.values(), ids=CASES)
@pytest.mark.parametrize("away", [{}, AWAY], ids=["as it is", "away"])
def test_the_extended_model_is_what_the_fit_has_seen(effects, away):
    model = curved_cell(effects=effects)
    coordinates, log = Coordinates(model), drive(1)
    seen, _ = gather(model, [(log, InitialSoc(SOC0, 0.01, "given"))]).simulate(coordinates, away)
    extended = extend_model(coordinates, away, {})
    np.testing.assert_allclose(simulate(extended, log, SOC0).voltage_V, seen, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("away", [
    {"rate_h": -0.08},
    {"rate_h": -0.08, "ln_capacity": 0.1, "lithium_loss": 0.01},
    {"rate_h": -0.08, "leak_A": -0.01, "m_V": -0.004, "rth_K_per_W": -0.8, "r3": -0.4},
])  # fmt: skip
@pytest.mark.parametrize("effects", CASES.values(), ids=CASES)
def test_however_far_a_fit_goes_what_it_saw_is_a_model(effects, away):
    """Tolerances of a calibrated baseline end beyond what an effect may be."""
    coordinates, log = Coordinates(curved_cell(effects=effects)), drive(1)
    start = InitialSoc(SOC0, 0.01, "given")
    seen, _ = gather(coordinates.model, [(log, start)]).simulate(coordinates, away)
    extended = extend_model(coordinates, away, {})
    if "r3" not in away:  # some of these a cell cannot have: the model goes without
        found = simulate(extended, log, SOC0).voltage_V
        np.testing.assert_allclose(found, seen, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    "effect",
    [
        ChargeTransfer(60.0),
        pytest.param(SurfaceSoc(0.06, 200.0, 1500.0), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    "cause", [pytest.param("resistance_scale", marks=pytest.mark.slow), "current_offset"]
)
def test_a_model_with_such_an_effect_is_diagnosed_and_keeps_it(cause, effect):
    """What is wrong is found beside the effect, which stays in the model as it was.

    The model states no more error than these logs have.
    """
    model = curved_cell(
        effects=(effect,), error=ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01)
    )
    logs = []
    for seed in (2, 3):
        asked = drive(seed, 3000)
        truth = model
        if cause == "resistance_scale":
            truth = extend_model(Coordinates(model), {"ln_scale": np.log(1.4)}, {})
        noise = 1e-3 * np.random.default_rng(seed).normal(size=len(asked))
        voltage = simulate(truth, asked, SOC0).voltage_V + noise
        offset = 0.15 if cause == "current_offset" else 0.0
        logs.append(CellLog(asked.time_s, asked.current_A + offset, voltage, asked.temperature_C))
    said = diagnose(model, logs[0], logs[1], soc0=SOC0)
    assert said.verdict == cause
    name, value = next(iter(said.causes[0].parameters.items()))
    assert value == pytest.approx({"scale": 1.4, "offset_A": 0.15}[name], rel=0.1)
    kept = said.extended_model.effect(type(effect))
    # Within the tolerance that each cause has of the surface's depth, which is a cause itself.
    assert vars(kept) == pytest.approx(vars(effect), rel=1e-3)


@pytest.mark.parametrize(
    "known", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["known", "not known"]
)
def test_the_logs_that_were_explained_widen_the_validity(known):
    """At its own temperature more resistance; the drive at 8 to 28 degC belongs to the data now.

    The model states no more error than the log has.
    """
    valid = Validity((0.6, 0.9), (25.0, 25.0), (-20.0, 20.0)) if known else UNKNOWN
    error = ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01)
    model, asked = curved_cell(validity=valid, error=error), drive(4, 3000)
    truth = extend_model(Coordinates(model), {"ln_scale": np.log(1.4)}, {})
    run = simulate(truth, asked, SOC0)
    noise = 1e-3 * np.random.default_rng(4).normal(size=len(asked))
    log = CellLog(asked.time_s, asked.current_A, run.voltage_V + noise, asked.temperature_C)
    extended = diagnose(model, log, soc0=SOC0).extended_model
    if not known:
        assert extended.validity == UNKNOWN
        return
    after = extended.validity
    assert after.soc == pytest.approx((min(0.6, run.soc.min()), max(0.9, run.soc.max())), abs=0.01)
    warm = float(np.min(asked.temperature_C)), float(np.max(asked.temperature_C))
    assert after.temperature_C == pytest.approx((warm[0], max(25.0, warm[1])), abs=0.1)
    assert after.current_A == (-20.0, 20.0)
