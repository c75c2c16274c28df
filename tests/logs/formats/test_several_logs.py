"""Several logs in one file are listed, and one is chosen by number or all are taken."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.logs.files.format import SeveralLogsError
from cellwise.logs.writing import write_columns
from cellwise.notices import Code, texts

TIME = np.arange(600) * 2.0


def test_of(k):
    """Time, current and voltage of a test whose rate says which it is."""
    current = np.where((TIME // 60) % 2 == 1, 1.0 + k, 0.0)
    return TIME, current, 4.0 - 0.05 * current - 0.3 * np.cumsum(current) / current.sum()


test_of.__test__ = False
TESTS = [test_of(k) for k in range(3)]
NAMES = ("t", "I", "V")


def cells_of(values):
    """A cell array, of arrays of one length too."""
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


def in_fields():
    return {
        "rate": {f"C{k + 1}": dict(zip(NAMES, one, strict=True)) for k, one in enumerate(TESTS)}
    }


def in_an_array():
    return {"trips": cells_of([dict(zip(NAMES, one, strict=True)) for one in TESTS])}


def in_cells():
    return {"d": {n: cells_of([one[j] for one in TESTS]) for j, n in enumerate(NAMES)}}


def in_matrices():
    wide = {n: np.column_stack([one[j] for one in TESTS]) for j, n in enumerate(NAMES)}
    return {"d": wide | {"t": TIME}}


def in_cycles():
    """As NASA's PCoE has them; its current is negative on discharge."""
    names = ("Time", "Current_measured", "Voltage_measured")
    data = [dict(zip(names, (t, -i, v), strict=True)) for t, i, v in TESTS]
    cycles = [{"type": "discharge", "ambient_temperature": 24, "data": one} for one in data]
    spectrum = {"Sense_current": np.ones(40) * 1j, "Battery_impedance": np.ones(48) * 1j}
    return {"B0005": {"cycle": cells_of([*cycles, {"type": "impedance", "data": spectrum}])}}


@pytest.mark.parametrize("made", [in_fields, in_an_array, in_cells, in_matrices, in_cycles])
def test_of_a_matlab_file_none_is_read_unless_it_is_chosen(tmp_path, made):
    from scipy.io import savemat

    path = tmp_path / "many.mat"
    savemat(path, made())
    with pytest.raises(SeveralLogsError, match=r"3 logs in .*`instance=K`") as refused:
        read_log(path)
    assert refused.value.numbers == (0, 1, 2)
    for k, (_, current, voltage) in enumerate(TESTS):
        log = read_log(path, instance=k)
        np.testing.assert_allclose(log.current_A, current)
        np.testing.assert_allclose(log.voltage_V, voltage)
        np.testing.assert_array_equal(read_log(f"{path}@instance={k}").current_A, log.current_A)
    with pytest.raises(InputError, match="up to 2"):
        read_log(path, instance=3)


def test_structures_in_an_array_of_matlab_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")

    path = tmp_path / "many.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        kept, trips = file.create_group("#refs#"), file.create_group("trips")
        for j, name in enumerate(NAMES):
            refs = trips.create_dataset(name, (3, 1), dtype=h5py.ref_dtype)
            for k, one in enumerate(TESTS):
                data = kept.create_dataset(f"{name}{k}", data=one[j].reshape(1, -1))
                refs[k, 0] = data.ref
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    with pytest.raises(SeveralLogsError, match="3 logs"):
        read_log(path)
    np.testing.assert_allclose(read_log(path, instance=2).current_A, TESTS[2][1])


def test_words_for_the_quantities_are_known_in_a_structure(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "one.mat"
    time, current, voltage = TESTS[1]
    savemat(path, {"d": {"Zeit_s": time, "Strom_mA": 1e3 * current, "Spannung_V": voltage}})
    np.testing.assert_allclose(read_log(path).current_A, current)


def test_history_takes_all_of_them(tmp_path, capsys):
    from scipy.io import savemat

    names = ("Time", "Current_measured", "Voltage_measured")
    time = np.arange(0.0, 7200.0, 20.0)
    cycles = []
    for share in (1.0, 0.9):
        used = np.minimum(time / 7000.0 / share, 1.0)
        voltage = 4.1 - 0.9 * used - 0.3 * used**8
        rows = used < 1.0
        one = (time[rows], np.full(rows.sum(), -1.0), voltage[rows])
        data = dict(zip(names, one, strict=True))
        cycles.append({"type": "discharge", "data": data})
    path = tmp_path / "B5.mat"
    savemat(path, {"B5": {"cycle": cells_of(cycles)}})
    told = ["history", "--model", "nmc-18650", "--capacity-ah", "2", "--anyway", str(path)]
    assert main(told) == 0
    shown = capsys.readouterr().out
    assert "B5@0" in shown
    assert "B5@1" in shown


def batteries(**more):
    """Rows of two batteries in turn, as a mavlink log has them."""
    rows = 2 * TIME.size
    of = np.arange(rows) % 2
    time, current, voltage = (np.repeat(x, 2) for x in TESTS[0])
    return {
        "time_s": time, "Inst": of, "current_A": np.where(of == 0, current, 0.4),
        "voltage_V": np.where(of == 0, 4 * voltage, 12.3), **more,
    }  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_of_two_batteries_in_a_table_one_is_read_and_the_first_notice_says_so(tmp_path, suffix):
    path = write_columns(batteries(), tmp_path / f"bat{suffix}")
    log = read_log(path, series=4)
    np.testing.assert_allclose(log.voltage_V, TESTS[0][2])
    np.testing.assert_allclose(log.current_A, TESTS[0][1])
    assert log.notices[0].code is Code.SEVERAL_BATTERIES
    assert read_log(path, instance=1, series=3).voltage_V == pytest.approx(np.full(600, 4.1))
    with pytest.raises(InputError, match="no battery 7"):
        read_log(path, instance=7)


def test_a_number_of_a_battery_for_a_table_of_one_is_refused(tmp_path):
    one = dict(zip(("time_s", "current_A", "voltage_V"), TESTS[0], strict=True))
    path = write_columns(one, tmp_path / "one.csv")
    assert len(read_log(path, instance=0)) == 600
    with pytest.raises(InputError, match="no battery 1"):
        read_log(path, instance=1)


def unsigned(value):
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def signed(value):
    return unsigned(2 * value if value >= 0 else -2 * value - 1)


HEADER = (
    "Product:Blackbox flight data recorder by Nicholas Sherlock", "Data version:2",
    "I interval:16", "P interval:1/1", "Firmware revision:Betaflight 4.5.1 (77d01ba3b) STM32F7X2",
    "Field I name:loopIteration,time,vbatLatest,amperageLatest", "Field I signed:0,0,0,1",
    "Field I predictor:0,0,0,0", "Field I encoding:1,1,1,0",
    "Field P predictor:6,2,1,1", "Field P encoding:9,0,0,0",
)  # fmt: skip


def session(time, current, voltage):
    """A blackbox recording, from its description: key frames and differences."""
    out = "".join(f"H {line}\n" for line in HEADER).encode()
    last = before = (0, 0, 0)
    for k, (t, i, v) in enumerate(zip(time, current, voltage, strict=True)):
        row = round(1e6 * t), round(100 * v), round(100 * i)
        if k % 16 == 0:
            out += b"I" + unsigned(k) + unsigned(row[0]) + unsigned(row[1]) + signed(row[2])
            before = row
        else:
            out += b"P" + signed(row[0] - 2 * last[0] + before[0])
            out += signed(row[1] - last[1]) + signed(row[2] - last[2])
            before = last
        last = row
    return out


def test_every_recording_of_a_blackbox_file_is_a_log(tmp_path):
    pytest.importorskip("orangebox")
    time, current, voltage = TESTS[2]
    path = tmp_path / "flight.bbl"
    whole = session(time, current, 4 * voltage) + b"E\xffEnd of log\x00"
    path.write_bytes(whole)
    log = read_log(path, series=4)
    assert log.format == "blackbox"
    np.testing.assert_allclose(log.time_s, time)
    np.testing.assert_allclose(log.current_A, current, atol=0.006)
    np.testing.assert_allclose(log.voltage_V, voltage, atol=0.002)
    path.write_bytes(whole[:3000])  # the power was cut
    cut = read_log(path, series=4)
    assert 300 < len(cut) < 600
    assert any("no end" in notice for notice in texts(cut.notices))
    path.write_bytes(whole + session(*test_of(0)) + b"E\xffEnd of log\x00")
    with pytest.raises(SeveralLogsError, match=r"0: session 1, .*1: session 2"):
        read_log(path)
    np.testing.assert_allclose(read_log(path, instance=1).current_A, TESTS[0][1], atol=0.006)
