"""The logs hold what a technician who programmed these tests would find."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "datasets"
Log = dict[str, np.ndarray]


def read(name: str) -> Log:
    table = pq.read_table(FOLDER / f"{name}.parquet")
    return {column: table[column].to_numpy() for column in table.column_names}


def pulses(log: Log, seconds: float) -> list[Log]:
    """Steps with current that last as long as a pulse."""
    found: list[Log] = []
    starts = np.flatnonzero(np.diff(log["step"])) + 1
    for start, stop in zip(starts, [*starts[1:], log["step"].size], strict=True):
        lasted = log["time_s"][stop - 1] - log["time_s"][start - 1]
        if log["current_A"][start] != 0.0 and abs(lasted - seconds) < 0.05:
            found.append({name: values[start:stop] for name, values in log.items()})
    return found


def is_trimmed(pulse: Log) -> bool:
    current = np.abs(pulse["current_A"])
    return bool(current[-1] < 0.97 * current[0])


@pytest.mark.parametrize(
    ("name", "rate_A"), [("cap_c20", 0.25), ("cap_c5", 1.0), ("cap_c3", 5.0 / 3.0)]
)
def test_nmc_capacity_ends_at_the_lower_limit(name, rate_A):
    log = read(f"nmc/{name}")
    discharge = log["step"] == 2
    assert log["current_A"][discharge].mean() == pytest.approx(rate_A, rel=1e-3)
    assert log["voltage_V"][discharge][-1] == pytest.approx(2.5, abs=3e-3)
    assert 4.8 < np.ptp(log["ampere_hours"][discharge]) < 5.16


def test_capacity_falls_with_rate():
    taken = [
        np.ptp((log := read(f"nmc/{n}"))["ampere_hours"][log["step"] == 2])
        for n in ("cap_c20", "cap_c5", "cap_c3")
    ]
    assert taken[0] > taken[1] > taken[2]


@pytest.mark.parametrize("name", ["cap_0p5c", "cap_1c", "cap_2c", "cap_3c"])
def test_lfp_capacity_has_a_cc_and_a_cv_part(name):
    log = read(f"lfp/{name}")
    constant_current, constant_voltage = log["step"] == 2, log["step"] == 3
    assert np.ptp(log["current_A"][constant_current]) < 0.02
    assert np.abs(log["voltage_V"][constant_voltage] - 2.0).max() < 3e-3
    assert log["current_A"][constant_voltage][-1] == pytest.approx(0.023, abs=0.01)
    assert 2.25 < log["ampere_hours"][constant_voltage][-1] < 2.31


def test_lfp_cv_part_grows_with_rate():
    parts = []
    for name in ("cap_0p5c", "cap_1c", "cap_2c", "cap_3c"):
        log = read(f"lfp/{name}")
        parts.append(np.ptp(log["ampere_hours"][log["step"] == 3]))
    assert parts == sorted(parts)
    assert parts[-1] > 2.0 * parts[0]


def test_lfp_hppc_has_18_tests_of_eight_pulses_of_one_minute():
    found = pulses(read("lfp/hppc"), 60.0)
    assert len(found) == 18 * 8
    rates = [round(float(np.abs(pulse["current_A"]).max()) / 2.3, 1) for pulse in found[8:16]]
    assert rates == [0.5, 0.5, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]


def test_lfp_hppc_turns_from_discharge_first_to_charge_first():
    first = [np.sign(pulse["current_A"][0]) for pulse in pulses(read("lfp/hppc"), 60.0)[::2]]
    turns = np.flatnonzero(np.diff(first))
    assert first[0] > 0 > first[-1]
    assert turns.size == 1


def test_lfp_hppc_is_trimmed_at_both_ends_and_only_there():
    found = pulses(read("lfp/hppc"), 60.0)
    trimmed = [k for k, pulse in enumerate(found) if is_trimmed(pulse)]
    signs = {float(np.sign(found[k]["current_A"][0])) for k in trimmed}
    assert signs == {-1.0, 1.0}
    assert all(k < 2 * 8 or k >= 16 * 8 for k in trimmed)
    for k in trimmed:
        limit = 2.0 if found[k]["current_A"][0] > 0 else 3.6
        assert found[k]["voltage_V"][-1] == pytest.approx(limit, abs=3e-3)


def test_nmc_hppc_trims_charge_pulses_of_the_full_cell():
    found = pulses(read("nmc/hppc"), 10.0)
    assert len(found) == 11 * 6
    charge = [pulse for pulse in found[:6] if pulse["current_A"][0] < 0]
    assert all(pulse["voltage_V"][-1] == pytest.approx(4.2, abs=3e-3) for pulse in charge)
    assert np.median(np.diff(found[30]["time_s"])) == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "current_A", "seconds"),
    [("hppc_c20", 0.25, 7200.0), ("hppc_c5", 1.0, 1800.0), ("hppc_c3", 5.0 / 3.0, 1080.0)],
)
def test_rate_hppc_is_the_paper_scaled(name, current_A, seconds):
    log = read(f"nmc/{name}")
    found = pulses(log, seconds)
    assert len(found) >= 9
    for pulse in found:
        assert pulse["current_A"].mean() == pytest.approx(current_A, rel=1e-3)
        assert np.median(np.diff(pulse["time_s"])) == pytest.approx(1.0, abs=1e-3)
    gaps = [b["time_s"][0] - a["time_s"][-1] for a, b in pairwise(found)]
    np.testing.assert_allclose(gaps, 3601.0, atol=0.1)


@pytest.mark.parametrize("name", ["drive_a", "drive_b", "drive_c"])
def test_drive_works_the_cell_in_both_directions(name):
    log = read(f"nmc/{name}")
    driving = log["step"] == 2
    current = log["current_A"][driving]
    assert 2.0 * 5.0 < current.max() < 3.0 * 5.0
    assert current.min() < -0.8 * 5.0
    assert np.median(np.diff(log["time_s"][driving])) == pytest.approx(1.0, abs=1e-3)
    depth = log["ampere_hours"][-1] / 5.1532
    assert 0.90 < depth < 0.95


def test_cold_cell_resists_more():
    """The drop 0.1 s into the 1C discharge pulse at half charge."""
    drops = []
    for name in ("hppc", "hppc_p00"):
        log = read(f"nmc/{name}")
        pulse = pulses(log, 10.0)[5 * 6 + 2]
        before = np.flatnonzero(log["step"] < pulse["step"][0])[-1]
        drops.append(log["voltage_V"][before] - pulse["voltage_V"][0])
        assert pulse["current_A"].mean() == pytest.approx(5.0, rel=1e-3)
    assert drops[1] > 1.3 * drops[0] > 0.0


def test_drives_are_three_routes():
    means = [read(f"nmc/{name}")["current_A"].mean() for name in ("drive_a", "drive_b", "drive_c")]
    assert means[0] < 0.6 * min(means[1:])


def test_depleting_cycles_take_their_share_each():
    log = read("lfp/cdc")
    ends = [log["ampere_hours"][log["step"] == k][-1] for k in range(1, 32)]
    shares = np.diff(ends) / 2.3
    # The first gives its regeneration up to the full cell, the last ones meet the lower limit.
    np.testing.assert_allclose(shares[1:25], 0.033, atol=1e-3)
    assert len(shares) == 30
