"""What the C is required to do, by number: each test stands on the compiled C and nothing else.

The numbers stand in comments of the C and in a table of docs/firmware.md.
"""

from __future__ import annotations

import ast
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cellwise.estimate.fixed.layout import INPUT, OUTPUT
from cellwise.estimate.status import Status
from cellwise.export.c_tables import firmware_folder
from cellwise.export.firmware import HostLibrary
from example_cells import curved_cell
from firmware_cases import VALID, tables_of

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
REPOSITORY = Path(__file__).resolve().parents[2]
NUMBER = re.compile(r"CW-\d{3}")
FLOATS = [name for name in OUTPUT.names if name != "status"]


@pytest.fixture(scope="module")
def plain():
    return HostLibrary(tables_of("plain"))


@pytest.fixture(scope="module")
def full():
    return HostLibrary(tables_of("full"))


def rows(count, current_A=1.0, voltage_V=np.nan, start=1, temperature_C=25.0):
    samples = np.zeros(count, dtype=INPUT)
    samples["current_A"], samples["voltage_V"] = current_A, voltage_V
    samples["temperature_C"] = temperature_C
    samples["sequence"] = start + np.arange(count)
    return samples


def begun(stepper, soc=0.6, std=0.01):
    """A state that has seen a rest of ten samples, numbers 1 to 10, at its own voltage."""
    state = stepper.state()
    stepper.begin(state, soc, std**2)
    at_rest_V = float(stepper.rows(state.copy(), rows(1, 0.0))["voltage_V"][0])
    stepper.rows(state, rows(10, 0.0, at_rest_V))
    return state


def predicted(stepper, state, samples):
    """The voltages that the filter itself expects of these samples."""
    return stepper.rows(state.copy(), samples)["voltage_V"]


def bits(outputs):
    return Status(int(np.bitwise_or.reduce(outputs["status"])))


@needs_gcc
@pytest.mark.parametrize("current_A", [np.nan, np.inf, 32767.0, -32768.0])
def test_a_current_that_no_cell_has_is_held_and_then_taken_for_lost(plain, current_A):
    """CW-001."""
    held, told = begun(plain), begun(plain)
    plain.rows(held, rows(5, 1.5, start=11))
    plain.rows(told, rows(5, 1.5, start=11))
    plain.rows(held, rows(8, 1.5, start=16))
    out = plain.rows(told, rows(8, current_A, start=16))
    assert np.all(out["status"] & Status.CURRENT_INVALID)
    assert np.all((out["status"] & Status.OUT_OF_RANGE != 0) == np.isfinite(current_A))
    assert told["soc"][0] == held["soc"][0]
    out = plain.rows(told, rows(60, current_A, start=24))
    assert out["status"][-1] & Status.CURRENT_LOST
    assert out["soc"][-1] == out["soc"][10]
    assert np.all(np.diff(out["soc_variance"][10:]) > 0)


@needs_gcc
@pytest.mark.parametrize("voltage_V", [np.nan, np.inf, -1.0, 0.0, 65.535])
def test_a_voltage_that_no_cell_gives_is_not_used(plain, voltage_V):
    """CW-002."""
    counting, told = begun(plain), begun(plain)
    plain.rows(counting, rows(40, 1.0, start=11))
    out = plain.rows(told, rows(40, 1.0, voltage_V, start=11))
    assert np.all(out["status"] & Status.VOLTAGE_INVALID)
    assert np.all(out["innovation_V"] == 0.0)
    assert told["soc"][0] == counting["soc"][0]
    assert out["status"][-1] & Status.VOLTAGE_LOST


@needs_gcc
def test_missing_numbers_widen_the_variance(plain):
    """CW-003: a few are bridged; over many nobody knows what flowed, and nothing is counted."""
    whole, short, long = begun(plain), begun(plain), begun(plain)
    plain.rows(whole, rows(4, 1.0, start=11))
    for state, number in ((short, 14), (long, 4000)):
        plain.rows(state, rows(1, 1.0, start=11))
        before = state.copy()
        out = plain.rows(state, rows(1, 1.0, start=number))
        assert out["status"][0] & Status.SEQUENCE_GAP
        assert out["soc_variance"][0] > before["ss"][0]
        if state is short:
            assert out["soc"][0] == pytest.approx(whole["soc"][0], abs=1e-7)
        else:
            one = 1.0 / (3600.0 * curved_cell().capacity_Ah)
            assert out["soc"][0] == pytest.approx(before["soc"][0] - one, abs=1e-6)
            deviation = np.sqrt(out["soc_variance"][0])
            assert deviation > 0.03


@needs_gcc
def test_a_number_that_comes_again_moves_nothing(plain):
    """CW-004."""
    state = begun(plain)
    before = state.copy()
    out = plain.rows(state, rows(1, 50.0, 3.0, start=10))
    assert out["status"][0] & Status.DUPLICATE
    assert state.tobytes() == before.tobytes()


@needs_gcc
@pytest.mark.parametrize("temperature_C", [np.nan, -80.0, 150.0])
def test_a_temperature_that_no_cell_has_is_held(full, temperature_C):
    """CW-005."""
    held, told = begun(full), begun(full)
    full.rows(held, rows(20, 1.0, start=11))
    out = full.rows(told, rows(20, 1.0, start=11, temperature_C=temperature_C))
    assert np.all(out["status"] & Status.TEMPERATURE_INVALID)
    assert told.tobytes() == held.tobytes()


@needs_gcc
def test_a_state_out_of_its_range_is_re_initialised(full):
    """CW-006: each number of it; and cleared memory, which knew an empty cell exactly."""
    good = begun(full)
    for name in good.dtype.names:
        if good.dtype[name].kind != "f" or name in ("cost", "weight"):  # a bank's: CW-019
            continue
        state = good.copy()
        state[name] = np.nan
        assert bits(full.rows(state, rows(1, 0.0, start=11))) & Status.STATE_RESET, name
    state = good.copy()
    state.view(np.uint8)[:] = 0
    out = full.rows(state, rows(1, 0.0, start=11))
    assert out["status"][0] & Status.STATE_RESET
    assert out["soc_variance"][0] >= 0.3**2


@needs_gcc
def test_no_output_is_ever_nan_and_soc_stays_within_its_bounds(full):
    """CW-007: any bits in the state and in the sample; Eva proves it for the builds it reads."""
    rng = np.random.default_rng(8)
    state = begun(full)
    for _ in range(3000):
        state.view(np.uint8)[:] = rng.integers(0, 256, state.nbytes)
        sample = np.frombuffer(rng.bytes(3 * INPUT.itemsize), dtype=INPUT).copy()
        out = full.rows(state, sample)
        assert all(np.all(np.isfinite(out[name])) for name in FLOATS)
        assert np.all((out["soc"] >= 0.0) & (out["soc"] <= 1.0))
    state = begun(full, soc=0.0005)
    out = full.rows(state, rows(300, 10.0, start=11))
    assert bits(out) & Status.CLAMPED
    assert out["soc"][-1] == 0.0


@needs_gcc
def test_a_voltage_beyond_the_gate_is_refused_and_not_for_ever(plain):
    """CW-008."""
    state, counting = begun(plain), begun(plain)
    current = np.resize([0.5, 1.0, 1.5], 2000)
    samples = rows(2000, current, start=11)
    samples["voltage_V"] = predicted(plain, state, samples) - 0.4
    expected = plain.rows(counting, rows(5, current[:5], start=11))
    first = plain.rows(state, samples[:5])
    assert np.all(first["status"] & Status.INNOVATION_REJECTED)
    assert first["soc"][-1] == expected["soc"][-1]
    later = plain.rows(state, samples[5:])
    recovered = np.flatnonzero(later["status"] & Status.GATE_RECOVERY)
    assert recovered.size
    assert later["soc_variance"][recovered[0]] > 100 * first["soc_variance"][-1]


@needs_gcc
def test_a_voltage_that_stands_still_under_a_changing_current_is_not_used(plain):
    """CW-009: nor one whose last digit dithers."""
    for dither_V in (0.0, 0.0004):
        state, counting = begun(plain), begun(plain)
        current = np.repeat([0.0, 3.0, -3.0], 40)
        samples = rows(120, current, start=11)
        stuck_V = float(predicted(plain, state, samples[:1])[0])
        samples["voltage_V"] = stuck_V + dither_V * (np.arange(120) % 2)
        out = plain.rows(state, samples)
        frozen = np.flatnonzero(out["status"] & Status.VOLTAGE_FROZEN)
        assert frozen.size > 60
        plain.rows(counting, rows(120, current, start=11))
        assert state["soc"][0] == pytest.approx(counting["soc"][0], abs=0.005)


@needs_gcc
def test_a_current_that_is_dead_is_found_by_the_voltage(plain):
    """CW-010."""
    state, driven = begun(plain), begun(plain)
    current = np.repeat(np.random.default_rng(2).normal(0.5, 2.0, 90), 10)
    samples = rows(900, current, start=11)
    samples["voltage_V"] = predicted(plain, driven, samples)
    samples["current_A"] = 0.0
    out = plain.rows(state, samples)
    assert bits(out[:300]) & Status.CURRENT_LOST
    truth = plain.rows(driven, rows(900, current, start=11))["soc"]
    off = np.abs(out["soc"] - truth)[300:]
    assert np.mean(off <= 2.0 * np.sqrt(out["soc_variance"][300:])) >= 0.9


@needs_gcc
def test_what_the_model_was_not_measured_at_is_said_and_trusted_less():
    """CW-018."""
    stepper = HostLibrary(tables_of("validity"))
    state = begun(stepper)
    inside = stepper.rows(state.copy(), rows(1, 1.0, start=11))
    beyond = stepper.rows(state.copy(), rows(1, 10.0, start=11))
    warm = stepper.rows(state.copy(), rows(1, 1.0, start=11, temperature_C=45.0))
    assert VALID.current_A[1] < 10.0
    assert not bits(inside) & Status.OUTSIDE
    for out in (beyond, warm):
        assert bits(out) & Status.OUTSIDE
        assert out["innovation_variance_V2"][0] > inside["innovation_variance_V2"][0]


@needs_gcc
def test_a_bank_whose_memory_is_damaged_begins_over_all_of_the_soc(plain):
    """CW-019."""
    for name, value in (("mismatch", np.nan), ("likeliest", 9), ("mean_A", np.inf)):
        bank, of = plain.start_bank(5, 0.5, 0.0225)
        plain.bank_rows(bank, of, rows(5, 1.0, 3.7))
        assert bank["spread"][0] == 1
        bank[name] = value
        out = plain.bank_rows(bank, of, rows(1, 1.0, 3.7, start=6))
        assert out["status"][0] & Status.STATE_RESET, name
        assert out["soc_variance"][0] > 0.05**2
        assert all(np.all(np.isfinite(out[field])) for field in FLOATS)


@needs_gcc
def test_the_memory_of_a_component_that_was_dropped_moves_nothing(plain):
    """CW-019: one bit of it that no longer mattered once gave a SOC of 1 for ever, unsaid."""
    banks = [plain.start_bank(5, 0.5, 0.0225) for _ in range(2)]
    for (bank, of), value in zip(banks, (0.3, np.nan), strict=True):
        plain.bank_rows(bank, of, rows(5, 1.0, 3.7))
        of["cost"][3], of["weight"][3] = 2.0**20, 0.0  # as `weigh_components` drops one
        for name in ("soc", "v2_V", "ss", "p11"):
            of[name][3] = value
    first, second = (plain.bank_rows(*bank, rows(50, 1.0, 3.7, start=6)) for bank in banks)
    assert banks[0][0]["spread"][0] == 1
    assert first.tobytes() == second.tobytes()


@needs_gcc
def test_a_bank_looks_at_the_past_whatever_its_first_number_is():
    """A target that has run for an hour numbers its first sample 3600."""
    slow = HostLibrary(tables_of("slow"))
    looks = []
    for start in (0, 3600):
        bank, of = slow.start_bank(5, 0.5, 0.0225)
        slow.bank_rows(bank, of, rows(80, 1.5, 3.7, start=start))
        looks.append(int(bank["looks"][0]))
    assert looks == [1, 1]


def in_c():
    """The numbers that stand in the C, printed or by hand."""
    files = [*firmware_folder().glob("*.c"), *firmware_folder().glob("*.h")]
    return {number for file in files for number in NUMBER.findall(file.read_text())}


def in_tests():
    """The numbers that tests name in what they say of themselves, with the names of the tests."""
    found: dict[str, set[str]] = {}
    for file in (REPOSITORY / "tests" / "firmware").glob("test_*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                for number in NUMBER.findall(ast.get_docstring(node) or ""):
                    found.setdefault(number, set()).add(f"{file.stem}.{node.name}")
    return found


def test_every_number_in_the_c_has_a_test_and_a_row_in_the_table():
    page = (REPOSITORY / "docs" / "firmware.md").read_text()
    rows_of = re.findall(r"^\| (CW-\d{3}) \|", page, re.M)
    assert len(set(rows_of)) == len(rows_of)
    assert in_c() == set(rows_of) == set(in_tests())
    assert len(rows_of) >= 19
