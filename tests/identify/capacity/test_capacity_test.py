"""Capacity tests: CC and CV parts, completeness, efficiency; theorems, embedded and real data."""

import numpy as np
import pytest
from scipy.optimize import brentq

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_test import measure_capacities
from cellwise.logs import CellLog, read_log

FULL_AH, R_OHM = 4.0, 0.03


def ocv(s):
    return 2.9 + 0.9 * s + 0.35 * (1 - np.exp(-s / 0.03)) + 0.05 * np.exp((s - 1) / 0.02)


class Tester:
    """Writes the log of a cell with an OCV and a resistance: the charge of every part is known."""

    __test__ = False

    def __init__(self, soc, row_s=5.0, charge_gain=1.0):
        self.soc, self.row_s, self.charge_gain = soc, row_s, charge_gain
        self.rows = [(0.0, 0.0, float(ocv(soc)), 0.0)]

    def _row(self, current, dt):
        time, _, _, counted = self.rows[-1]
        moved = current * dt / 3600.0
        self.soc -= moved / FULL_AH
        gain = self.charge_gain if current < 0 else 1.0
        voltage = float(ocv(self.soc)) - R_OHM * current
        self.rows.append((time + dt, current * gain, voltage, counted + moved * gain))

    def rest(self, duration=1800.0):
        for _ in range(int(duration / 60)):
            self._row(0.0, 60.0)
        return self

    def move(self, current, limit, charge=np.inf):
        """Constant current until the limit or, before it, until the charge has flowed."""
        end = brentq(lambda s: ocv(s) - R_OHM * current - limit, -1.0, 2.0)
        moved = min(charge, max(FULL_AH * (self.soc - end) * np.sign(current), 0.0))
        seconds = 3600.0 * moved / abs(current)
        for dt in np.diff(np.append(np.arange(0.0, seconds, self.row_s), max(seconds, 1e-6))):
            self._row(current, dt)
        return self

    def hold(self, voltage, until):
        while abs(current := (float(ocv(self.soc)) - voltage) / R_OHM) > until:
            self._row(current, self.row_s / 5)
        return self

    def discharge(self, current, limit=2.5, until=None):
        self.move(current, limit)
        return self if until is None else self.hold(limit, until)

    def charge(self, current, limit=4.2, until=0.05):
        return self.move(-current, limit).hold(limit, until)

    def log(self, name="test", counter=True, start=0, stop=None):
        t, i, v, q = np.array(self.rows[start:stop]).T
        return CellLog(t - t[0], i, v, charge_Ah=q - q[0] if counter else None, name=name)


def test_cc_part_ends_at_the_limit_and_cv_part_is_the_rest():
    tester = Tester(1.0).rest()
    tester.move(4.0, 2.9)
    cc = FULL_AH * (1.0 - tester.soc)
    tester.hold(2.9, 0.04)
    total = FULL_AH * (1.0 - tester.soc)
    (test,) = measure_capacities([tester.rest().log()], nominal_Ah=4.0)
    assert test.cc_Ah == pytest.approx(cc, rel=2e-3)
    assert test.total_Ah == pytest.approx(total, rel=1e-6)
    assert test.cv_Ah == pytest.approx(total - cc, rel=0.1)
    assert test.rate_C == pytest.approx(1.0)
    assert test.complete


@pytest.mark.parametrize("row_s", [1.0, 10.0, 60.0])
@pytest.mark.parametrize("counter", [True, False])
def test_total_does_not_depend_on_rows_or_counter(row_s, counter):
    tester = Tester(1.0, row_s).rest().discharge(2.0)
    expected = FULL_AH * (1.0 - tester.soc)
    (test,) = measure_capacities([tester.rest().log(counter=counter)])
    assert test.total_Ah == pytest.approx(expected, rel=1e-6)
    assert test.cv_Ah == pytest.approx(0.0, abs=2e-3)


def test_efficiency_is_what_came_out_over_what_went_in():
    tester = Tester(1.0, charge_gain=1.02).rest()
    for _ in range(2):
        tester.discharge(4.0).rest().charge(2.0, until=0.01).rest()
    tests = measure_capacities([tester.log()])
    for test in tests:
        assert test.coulombic_efficiency == pytest.approx(1 / 1.02, rel=3e-3)


def test_discharge_alone_without_any_rest():
    (test,) = measure_capacities([Tester(1.0).discharge(4.0).log(start=1)])
    assert test.complete


def test_logs_that_follow_one_another_are_one_test():
    tester = Tester(1.0).rest().discharge(0.2).rest().hold(2.5, 0.004).rest()
    (whole,) = measure_capacities([tester.log()])
    for cut in (700, 1500):
        parts = [tester.log("a", stop=cut), tester.log("b", start=cut - 1)]
        (joined,) = measure_capacities([parts])
        assert joined.total_Ah == pytest.approx(whole.total_Ah, rel=1e-9)
        assert joined.cc_Ah == pytest.approx(whole.cc_Ah, rel=1e-9)


def test_a_test_that_stops_early_is_marked_by_the_others():
    whole = Tester(1.0).rest().discharge(4.0).rest().log("whole")
    early = Tester(1.0).rest().move(4.0, 2.5, charge=2.5).rest().log("early")
    good, bad = measure_capacities([whole, early])
    assert good.complete
    assert not bad.complete
    assert "lower limit is 2.5" in bad.notices[0].text


def test_a_lone_test_that_stops_in_the_middle_is_not_believed():
    early = Tester(1.0).rest().move(4.0, 2.5, charge=1.83).rest().log()
    (test,) = measure_capacities([early])
    assert not test.complete
    assert "give the lower limit" in test.notices[0].text


def test_a_discharge_that_did_not_begin_full_is_marked():
    halfway = Tester(0.6).rest().discharge(4.0).rest().charge(2.0).rest().log("halfway")
    (test,) = measure_capacities([halfway])
    assert not test.complete
    assert "in to full" in test.notices[0].text


@pytest.mark.parametrize("kind", ["rest", "charge", "drive", "hppc"])
def test_without_a_constant_current_discharge_there_is_no_test(kind):
    tester = Tester(0.95 if kind != "charge" else 0.1).rest()
    if kind == "charge":
        tester.charge(2.0)
    if kind == "drive":
        rng = np.random.default_rng(1)
        for current in rng.uniform(-2.0, 10.0, 300):
            tester.move(current, 2.5 if current > 0 else 4.2, charge=abs(current) * 30 / 3600)
    if kind == "hppc":
        for _ in range(9):
            tester.move(2.0, 2.5, charge=0.4).rest(3600)
    with pytest.raises(InputError, match="no discharge at constant current"):
        measure_capacities([tester.log()])
    with pytest.raises(InputError, match="no log"):
        measure_capacities([[]])


def test_embedded_lfp_cell_gives_the_same_total_at_every_rate(datasets):
    names = ("cap_0p5c", "cap_1c", "cap_2c", "cap_3c")
    logs = [read_log(datasets / "lfp" / f"{name}.parquet") for name in names]
    tests = measure_capacities(logs, nominal_Ah=2.3)
    # CC to 2.0 V, then CV to 1 % of nominal: always the same end, by way of different CC parts.
    assert np.ptp([t.total_Ah for t in tests]) < 1e-3
    assert np.all(np.diff([t.cc_Ah for t in tests]) < -0.01)
    assert np.all(np.array([t.cv_Ah for t in tests]) > 0.01)
    assert [t.rate_C for t in tests] == pytest.approx([0.5, 1.0, 2.0, 3.0], rel=1e-3)
    for t in tests:
        assert t.coulombic_efficiency == pytest.approx(1.0, abs=1e-3)


PUBLISHED = [
    ("panasonic_18650pf/cap_1c_p25_start_1", 2.798, 1),
    ("panasonic_18650pf/cap_1c_p25_start_2", 2.752, 1),
    ("panasonic_18650pf/cap_1c_p25_end_1", 2.434, 1),
    ("panasonic_18650pf/cap_1c_p25_end_2", 2.354, 1),
    ("panasonic_18650pf/ocv_c20_p25", 2.997, 1),
    ("nissan_leaf/cap_1c_p23", 30.3, 4),
    ("nissan_leaf/cap_2c_p23", 29.9, 5),
    ("nissan_leaf/cap_3c_p23", 28.5, 5),
    ("lg_18650hg2/cap_0p5c_p25_549", 2.726, 1),
    ("lg_18650hg2/cap_1c_n20_610", 1.671, 1),
    ("lg_18650hg2/cap_1c_p10_576", 2.547, 1),
]


@pytest.mark.parametrize(("path", "capacity_Ah", "rounds"), PUBLISHED)
def test_measured_capacities_are_those_published(real_data, path, capacity_Ah, rounds):
    tests = measure_capacities([read_log(real_data / f"{path}.csv.gz")])
    assert len(tests) == rounds
    assert all(t.complete for t in tests)
    assert np.median([t.total_Ah for t in tests]) == pytest.approx(capacity_Ah, rel=2e-3)


def test_leaf_rounds_have_an_efficiency_of_one(real_data):
    tests = measure_capacities([read_log(real_data / "nissan_leaf/cap_2c_p23.csv.gz")])
    assert [t.coulombic_efficiency for t in tests] == pytest.approx([1.0] * 5, abs=2e-3)


@pytest.mark.parametrize("tag", ["n25", "n15", "n05", "p05", "p15", "p25", "p35", "p45"])
def test_a123_discharge_in_two_logs_is_one_capacity(real_data, tag):
    parts = [read_log(real_data / f"plett_a123/ocv_{tag}_s{k}.csv.gz") for k in (1, 2)]
    (test,) = measure_capacities([parts])
    assert test.complete
    assert test.total_Ah == pytest.approx(2.0725, rel=3e-3)  # its README: 2.068 to 2.076 Ah
