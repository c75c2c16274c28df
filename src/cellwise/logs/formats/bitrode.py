"""Bitrode CSV: ``Time(s)`` with ``Mode`` (CHRG, DCHG, REST), charge positive."""

from __future__ import annotations

from cellwise.logs.files.columns import CLOCK, OWN, TURNED, Channel
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.text_cells import labels

_MODE = labels(DCHG=1.0, DCHRG=1.0, DISCHARGE=1.0, CHRG=-1.0, CHG=-1.0, CHARGE=-1.0, REST=0.0)

BITRODE_CSV = Format(
    name="bitrode-csv",
    matches=lambda source: has_names(
        source, ("Mode",), ("Exclude", "Loop", "Loop Counter #1"), ("Current(A)", "Current")
    ),
    channels=(
        Channel(
            "time_s",
            {"Time(s)": OWN, "Total Time(s)": OWN, "Test Time(s)": OWN, "Total Time": CLOCK},
            required=True,
        ),
        Channel("current_A", {"Current(A)": OWN, "Current": OWN}, required=True),
        Channel("voltage_V", {"Voltage(V)": OWN, "Voltage": OWN}, required=True),
        Channel(
            "temperature_C", {"Temperature(C)": OWN, "Temperature": OWN, "Temperature A1": OWN}
        ),
        Channel("charge_Ah", {"Capacity(Ah)": TURNED, "Amp-Hours": TURNED, "Ah": TURNED}),
        Channel("step", {"Step": OWN}),
        Channel("direction", {"Mode": _MODE}),
    ),
    known=(
        *(
            "Exclude",
            "Cycle",
            "Loop",
            "StepTime(s)",
            "Step Time",
            "Power(W)",
            "Power",
            "Energy(Wh)",
        ),
        *("Watt-Hours", "Data", "Data Acquisition Flag", "Loop Counter #1", "Loop Counter #2"),
        *("Loop Counter #3",),
    ),
    read=read_csv,
    sign="charge-positive",
)
