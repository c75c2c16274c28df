"""What a refusal proposes reads, and is right: over tables of many names, units and layouts."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.logs import read_log

STEP_S = 5.0
ROWS = 240
TIME = STEP_S * np.arange(ROWS)
CURRENT = np.select([(TIME > 100) & (TIME < 500), (TIME > 650) & (TIME < 900)], [2.0, -1.0], 0.0)
DRAWN = np.cumsum(CURRENT) * STEP_S / 3600
VOLTAGE = 4.0 - 0.8 * DRAWN - 0.04 * CURRENT
PROPOSED = re.compile(r"Name the columns with `channels=(\{.*?\})`")

# Words alone, in the order of time, voltage, current; what stands behind says the unit, or nothing.
WORDS = [
    ("Time", "Voltage", "Current"),
    ("Test time", "Cell voltage", "Cell current"),
    ("elapsed", "volts", "amps"),
    ("Zeit", "Spannung", "Strom"),
    ("Temps", "Tension", "Courant"),
    ("Tiempo", "Voltaje", "Corriente"),
    ("Tempo", "Tensione", "Corrente"),
    ("Tijd", "Spanning", "Stroom"),
    ("Czas", "Napięcie", "Prąd"),
    ("Время", "Напряжение", "Ток"),
    ("测试时间", "电池电压", "电流"),
    ("経過時間", "電圧", "電流"),
    ("시간", "전압", "전류"),
    ("log_time", "packVoltage", "pack_current"),
    ("t", "U", "I"),
    ("Runtime", "Vbat", "Ibat"),
    ("Timestamp", "Battery bus voltage", "Battery wire current"),
    ("Record time", "Ewe", "amperageLatest"),
]
UNITS = {
    "s": (("s", 1.0), ("ms", 1e3), ("min", 1 / 60), ("h", 1 / 3600)),
    "V": (("V", 1.0), ("mV", 1e3), ("uV", 1e6), ("0.01V", 1e2)),
    "A": (("A", 1.0), ("mA", 1e3), ("uA", 1e6), ("0.01A", 1e2)),
}
STYLES = ("{} ({})", "{} [{}]", "{}/{}", "{}_{}", "{}, {}", "{}")
# Columns of something else, that pretend: name, and factors of current and voltage.
DECOYS = [
    ("Motor current (A)", 3.1, 0.0),
    ("Requested Amps", 0.0, -2.0),
    ("Max voltage (V)", 0.0, 1.0),
    ("temp_mos_max", 0.1, 7.0),
    ("Bat%(%)", 0.0, 22.0),
    ("Power (W)", 3.7, 0.0),
    ("Setpoint", 1.0, 0.0),
    ("SOC", -1.0, 25.0),
    ("Step time (s)", 0.0, 3.0),
    ("rssi", 0.0, 11.0),
]


@st.composite
def tables(draw):
    """Text of a table, and whether its sign is that of discharge."""
    words = draw(st.sampled_from(WORDS))
    style = draw(st.sampled_from(STYLES))
    sign = draw(st.sampled_from([1.0, -1.0]))
    series = {"s": TIME, "V": VOLTAGE, "A": sign * CURRENT}
    columns = []
    for word, quantity in zip(words, series, strict=True):
        which = UNITS[quantity] if style != "{}" else UNITS[quantity][:2]
        unit, factor = draw(st.sampled_from(which))
        if "/" in style and "0.01" in unit:
            unit, factor = quantity, 1.0
        columns.append((style.format(word, unit), factor * series[quantity]))
    for name, of_current, of_voltage in draw(
        st.lists(st.sampled_from(DECOYS), max_size=4, unique=True)
    ):
        columns.append((name, of_current * CURRENT + of_voltage * VOLTAGE))
    columns = draw(st.permutations(columns))
    delimiter, decimal = draw(st.sampled_from([(",", "."), (";", ","), ("\t", "."), (";", ".")]))
    above = draw(st.sampled_from(["", "Device: X-1\nChannel: 3\n\n", "# a comment\n"]))
    names = [f'"{name}"' if delimiter in name else name for name, _ in columns]
    rows = [
        delimiter.join(f"{x:.7g}".replace(".", decimal) for x in row)
        for row in zip(*(values for _, values in columns), strict=True)
    ]
    return above + "\n".join([delimiter.join(names), *rows]) + "\n"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(tables())
def test_what_is_proposed_reads_and_is_the_battery(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    try:
        log = read_log(path)
    except InputError as refusal:
        found = PROPOSED.search(refusal.action)
        if found is None:
            return  # none was found to fit
        log = read_log(path, channels=ast.literal_eval(found[1]))
    if "sign='charge-positive'" in log.notices[0].text:  # tidy names say that theirs is discharge
        log = read_log(path, sign="charge-positive")
    assert np.nanmedian(log.voltage_V) == pytest.approx(np.median(VOLTAGE), rel=1e-3)
    np.testing.assert_allclose(log.current_A, CURRENT, atol=1e-3)
