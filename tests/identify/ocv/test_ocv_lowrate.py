"""OCV from low-rate branches: known curves and gaps come back, cut branches are recognised."""

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.logs import CellLog, read_log

CAPACITY_AH, CURRENT_A = 2.5, 0.125  # C/20


def ocv(s):
    return (
        3.28
        + 0.02 * np.tanh((s - 0.7) / 0.03)
        + 0.05 * s
        - 0.7 * np.exp(-s / 0.03)
        + 0.2 * np.exp((s - 1.0) / 0.02)
    )


def segment(soc, current_A, gap_V, row_s=60.0, gain=1.0, name="made"):
    """Rest, the SOC path at one current with half the gap, rest: a log of its own."""
    soc = np.asarray(soc)
    dt = np.abs(np.diff(soc)) * CAPACITY_AH / abs(current_A) * 3600
    rest = np.arange(1, 31) * row_s
    t = np.concatenate(([0.0], rest, rest[-1] + np.cumsum(dt)))
    t = np.concatenate((t, t[-1] + rest))
    before, after = np.zeros(31), np.zeros(30)
    current = np.concatenate((before, np.full(dt.size, current_A * gain), after))
    loaded = ocv(soc[1:]) - np.sign(current_A) * 0.5 * gap_V
    v = np.concatenate((np.full(31, ocv(soc[0])), loaded, np.full(30, ocv(soc[-1]))))
    q = np.concatenate((before, np.cumsum(current[31:-30] * dt) / 3600))
    q = np.concatenate((q, np.full(30, q[-1])))
    return CellLog(t, current, v, charge_Ah=q, name=name)


def down(a=1.0, b=0.0, gap=0.04, **more):
    return segment(np.linspace(a, b, 1001), CURRENT_A, gap, **more)


def up(a=0.0, b=1.0, gap=0.04, **more):
    return segment(np.linspace(a, b, 1001), -CURRENT_A, gap, **more)


MIDDLE = np.linspace(0.05, 0.95, 181)


def gap_V(curve, low=0.05, high=0.95):
    inside = (curve.soc > low) & (curve.soc < high)
    return (curve.charge_V - curve.discharge_V)[inside]


def test_the_discharge_is_the_curve_and_the_charge_lies_by_the_gap_above_it():
    curve = ocv_from_low_rate([down(), up()])
    assert curve.capacity_Ah == pytest.approx(CAPACITY_AH)
    assert curve.function.evaluate(MIDDLE) == pytest.approx(ocv(MIDDLE) - 0.02, abs=1e-3)
    assert gap_V(curve) == pytest.approx(0.04, abs=1e-3)
    assert np.all(np.diff(curve.voltage_V) > 0.0)


@pytest.mark.parametrize("rows", [20_001, 80_001])
def test_rows_every_second_or_less_are_no_single_point(rows):
    """Neighbours that say the same are not all one: 80,001 rows are C/20 at 0.9 s."""
    dense = segment(np.linspace(1.0, 0.0, rows), CURRENT_A, 0.04, row_s=1.0)
    curve = ocv_from_low_rate([dense])
    known = ocv(MIDDLE) - 0.02
    assert curve.function.evaluate(MIDDLE) == pytest.approx(known, abs=1e-3)


def test_incomplete_charge_ends_where_it_stopped():
    curve = ocv_from_low_rate([down(), up(0.0, 0.85)])
    assert curve.function.evaluate(MIDDLE) == pytest.approx(ocv(MIDDLE) - 0.02, abs=1e-3)
    assert np.isfinite(curve.charge_V[curve.soc < 0.84]).all()
    assert np.isnan(curve.charge_V[curve.soc > 0.86]).all()
    assert curve.source.startswith("discharge branch")


def test_a_charge_alone_is_the_curve():
    curve = ocv_from_low_rate(up())
    assert curve.function.evaluate(MIDDLE) == pytest.approx(ocv(MIDDLE) + 0.02, abs=1e-3)
    assert curve.source.startswith("charge branch")


def test_a_counter_that_runs_ahead_on_charge_does_not_tilt_its_branch():
    curve = ocv_from_low_rate([down(), up(gain=1.04)])
    assert gap_V(curve) == pytest.approx(0.04, abs=1e-3)


def test_fast_logs_and_rests_are_refused():
    fast = segment(np.linspace(1.0, 0.0, 1001), 10 * CAPACITY_AH, 0.1)
    with pytest.raises(InputError, match="slower than C/2"):
        ocv_from_low_rate(fast)
    t = np.arange(0.0, 36000.0, 60.0)
    with pytest.raises(InputError, match="slower than C/2"):
        ocv_from_low_rate(CellLog(t, np.zeros(t.size), np.full(t.size, 3.3)))


def test_panasonic_charge_is_incomplete(real_data):
    curve = ocv_from_low_rate(read_log(real_data / "panasonic_18650pf/ocv_c20_p25.csv.gz"))
    assert curve.capacity_Ah == pytest.approx(2.997, abs=1e-3)
    assert curve.source.startswith("discharge branch")
    assert any("charge branch: 2.61" in note.text for note in curve.notes)
    assert np.isnan(curve.charge_V[curve.soc > 0.9]).all()
    assert np.std(curve.points_V - curve.function.evaluate(curve.points_soc)) < 5e-4


@pytest.mark.parametrize("tag", ["n25", "n15", "n05", "p05", "p15", "p25", "p35", "p45"])
def test_a123_branches_enclose_the_ocv_at_every_temperature(real_data, tag):
    logs = [read_log(real_data / f"plett_a123/ocv_{tag}_s{k}.csv.gz") for k in (1, 2, 3, 4)]
    curve = ocv_from_low_rate(logs)
    assert curve.capacity_Ah == pytest.approx(2.0725, rel=3e-3)
    assert np.all(gap_V(curve, 0.1, 0.85) > 0.01)  # hysteresis and polarisation never vanish
    assert np.all(np.diff(curve.voltage_V) > 0.0)


def test_lg_charge_counter_runs_ahead_without_crossing_the_branches(real_data):
    # Its charge counts 7 % more than its discharge: laid by the counter the branches would cross.
    curve = ocv_from_low_rate(read_log(real_data / "lg_18650hg2/ocv_c20_p25_549.csv.gz"))
    assert np.all(gap_V(curve, 0.02, 0.98) > 0.0)


def test_embedded_nmc_charge_ends_where_the_physics_model_says(datasets):
    # Catalogue: the C/20 charge without CV ends at SOC 0.9867 of an inventory that began at 0.997.
    curve = ocv_from_low_rate(read_log(datasets / "nmc/ocv_c20.parquet"))
    last = curve.soc[np.isfinite(curve.charge_V)][-1]
    assert last == pytest.approx(1.0 - (0.99701 - 0.9867), abs=6e-3)
