"""The sign check: right, mirrored by a flip, and silent where there is nothing to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.logs import CellLog, read_log, verify_sign
from cellwise.notices import texts
from log_files import pulse_channels, write_csv

OPPOSITE = {
    "verified": "contradicted",
    "contradicted": "verified",
    "undetermined": "undetermined",
}


def flipped(log: CellLog) -> CellLog:
    return replace(log, current_A=-log.current_A)


def cell(time, current, tau=30.0, r0=0.02, r1=0.02, capacity=3.0, slope=0.8) -> np.ndarray:
    """Voltage of a cell with R0, one RC pair and a linear OCV; exact for held current."""
    voltage = np.empty(time.size)
    branch, charge = 0.0, 0.0
    for k, dt in enumerate(np.diff(time, prepend=time[0])):
        a = np.exp(-dt / tau)
        branch = a * branch + (1 - a) * r1 * current[k]
        charge += current[k] * dt / 3600.0
        voltage[k] = 3.9 - slope * charge / capacity - r0 * current[k] - branch
    return voltage


def read_apart(late_rows):
    """At the full rate the correlation of dV and dI then tells nothing, or the wrong thing."""
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 600.0, 0.1)
    current = np.repeat(np.abs(rng.normal(10.0, 6.0, 600)), 10)
    voltage = np.roll(cell(time, current), late_rows) + rng.normal(0, 0.02, time.size)
    return time, current, voltage


def constant_current():
    """Without an edge: by the drift."""
    time = np.arange(0.0, 3000.0, 10.0)
    return time, np.full(300, 3.0), 4.0 - 0.9 * time / 3000 - 0.1 * (time / 3000) ** 8


def one_short_pulse_in_a_long_rest():
    time = np.arange(0.0, 7200.0, 1.0)
    current = np.where((time >= 3600) & (time < 3610), 5.0, 0.0)
    noise = np.random.default_rng(6).normal(0, 1e-3, time.size)
    return time, current, cell(time, current) + noise


def pulses(seconds=1200, *, holed=False):
    c = pulse_channels(seconds)
    if holed:
        c["current_A"][::13] = c["voltage_V"][::17] = np.nan
        c["time_s"] = c["time_s"] + np.where(c["time_s"] > 3000, 86400.0, 0.0)
    return c["time_s"], c["current_A"], c["voltage_V"]


LOGS = {
    "pulses": pulses(),
    "missing values and a gap": pulses(6000, holed=True),
    "constant current": constant_current(),
    "one short pulse": one_short_pulse_in_a_long_rest(),
    **{f"read {k} rows apart": read_apart(k) for k in (-5, -2, 0, 2, 5, 20)},
}


@pytest.mark.parametrize("name", LOGS)
def test_a_load_is_verified_with_evidence_and_its_flip_contradicted(name):
    log = CellLog(*LOGS[name])
    check = verify_sign(log)
    assert check.verdict == "verified"
    assert check.evidence
    assert verify_sign(flipped(log)).verdict == "contradicted"


@pytest.mark.parametrize("offset", [0.0, 0.005, 0.05])
@pytest.mark.parametrize("rising", [1.0, -1.0])
def test_a_rest_is_undetermined_whatever_the_sensor_zero(offset, rising):
    """A relaxing voltage under a sensor's zero is no evidence of anything."""
    rng = np.random.default_rng(7)
    time = np.arange(0.0, 3600.0, 1.0)
    current = offset + rng.normal(0, 0.002, time.size)
    voltage = 3.7 - rising * 0.08 * np.exp(-time / 400.0) + rng.normal(0, 2e-4, time.size)
    assert verify_sign(CellLog(time, current, voltage)).verdict == "undetermined"


def test_noise_is_undetermined():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time = np.arange(2000.0)
        log = CellLog(time, rng.normal(0, 1.0, 2000), 3.7 + rng.normal(0, 0.01, 2000))
        assert verify_sign(log).verdict == "undetermined", seed


def test_charge_positive_turns_current_and_counter_round(tmp_path):
    truth, columns = pulse_channels(), pulse_channels()
    for name in ("current_A", "ampere_hours"):
        columns[name] = -columns[name]
    log = read_log(write_csv(tmp_path / "log.csv", columns), sign="charge-positive")
    np.testing.assert_array_equal(log.current_A, truth["current_A"])
    np.testing.assert_array_equal(log.charge_Ah, truth["ampere_hours"])
    assert verify_sign(log).verdict == "verified"
    assert not any("LOOKS WRONG" in notice for notice in texts(log.notices))


@pytest.mark.slow
def test_every_measured_log_and_its_flip(real_data):
    """Never a wrong word; a verdict on nearly all, and the same one mirrored."""
    files = sorted(real_data.glob("*/*.csv.gz"))
    told = 0
    for path in files:
        log = read_log(path)
        verdict = verify_sign(log).verdict
        assert verdict != "contradicted", path.name
        assert verify_sign(flipped(log)).verdict == OPPOSITE[verdict], path.name
        told += verdict == "verified"
    assert told >= 0.98 * len(files)


def test_parts_of_measured_logs(real_data):
    """Ten minutes anywhere: undetermined is an answer, contradicted is not."""
    rng = np.random.default_rng(8)
    verdicts = []
    for path in sorted(real_data.glob("*/*.csv.gz"))[::8]:
        log = read_log(path)
        for start in rng.uniform(0, max(log.duration_s - 600.0, 1.0), 5):
            rows = np.flatnonzero((log.time_s >= start) & (log.time_s < start + 600.0))
            if rows.size > 10:
                verdicts.append(verify_sign(log.rows(rows)).verdict)
    assert "contradicted" not in verdicts
    assert verdicts.count("verified") > 0.5 * len(verdicts)


@pytest.mark.parametrize("name", ["lfp_cap_0p5c", "lfp_cap_1c", "lfp_cap_2c", "lfp_cap_3c"])
def test_a_discharge_that_begins_under_load_and_ends_at_a_held_voltage(name):
    """A plateau moves little: the one pair in which the tester holds the voltage is no evidence."""
    log = load_dataset(name)
    loaded = log.current_A > 0.5 * np.nanmax(log.current_A)
    first = int(np.argmax(loaded))
    for end in (int(np.argmin(log.voltage_V)), first + int(0.9 * np.argmin(loaded[first:]))):
        part = replace(log.part(first, end + 1), charge_Ah=None)
        assert verify_sign(part).verdict == "verified"
        assert verify_sign(flipped(part)).verdict == "contradicted"


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_small_cell_is_a_cell(size):
    """The verdict of a test does not depend on how large its cell is."""
    time = np.arange(0.0, 40_000.0, 30.0)
    current = np.where((time > 1000) & (time < 30_000), 0.2, 0.0)
    noise = np.random.default_rng(3).normal(0.0, 2e-4, time.size)
    log = CellLog(time, size * current, cell(time, current, capacity=2.0) + noise)
    assert verify_sign(log).verdict == "verified"
    assert verify_sign(flipped(log)).verdict == "contradicted"


def test_a_sensor_s_zero_on_a_cell_that_recovers_is_no_small_cell():
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 7200.0, 1.0)
    voltage = 2.9 + 0.35 * (1.0 - np.exp(-time / 900.0)) + rng.normal(0.0, 1e-3, time.size)
    for current in (rng.normal(0.003, 0.003, time.size), rng.choice([0.0, 0.01], time.size)):
        check = verify_sign(CellLog(time, current, voltage))
        assert check.verdict == "undetermined"
        assert check.evidence[0].startswith("at rest")
