"""Arbin CSV, MITS Pro 4 to 8: ``Test_Time(s)`` and ``Test Time (s)``, charge positive."""

from __future__ import annotations

from cellwise.logs.files.columns import MILLI, OWN, Channel
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format

_TIME = {"Test_Time(s)": OWN, "Test_Time": OWN}
_OF_ARBIN = (
    *("Data_Point", "Step_Index", "Cycle_Index", "Step_Time(s)", "Step_Time", "TC_Counter1"),
    *("Charge_Capacity(Ah)", "Discharge_Capacity(Ah)", "Charge_Capacity", "dV/dt(V/s)"),
)

ARBIN_CSV = Format(
    name="arbin-csv",
    matches=lambda source: has_names(source, tuple(_TIME), _OF_ARBIN),
    channels=(
        Channel("time_s", _TIME, required=True),
        Channel("current_A", {"Current(A)": OWN, "Current": OWN, "Current(mA)": MILLI}, True),
        Channel("voltage_V", {"Voltage(V)": OWN, "Voltage": OWN, "Voltage(mV)": MILLI}, True),
        Channel(
            "temperature_C",
            {
                "Aux_Temperature_1(C)": OWN,
                "Aux_Temperature(°C)_1": OWN,
                "Aux_Temperature(C)_1": OWN,
                "Aux_Temperature(¡æ)_1": OWN,  # the degree sign of a Chinese Windows
                "Aux_Temperature_1": OWN,
                "Temperature(C)_1": OWN,
                "Temperature(°C)": OWN,
                "Temperature(C)": OWN,
                "Temperature": OWN,
            },
        ),
        Channel(
            "charged_Ah",
            {"Charge_Capacity(Ah)": OWN, "Charge_Capacity": OWN, "Charge_Capacity(mAh)": MILLI},
        ),
        Channel(
            "discharged_Ah",
            {
                "Discharge_Capacity(Ah)": OWN,
                "Discharge_Capacity": OWN,
                "Discharge_Capacity(mAh)": MILLI,
            },
        ),
        Channel("step", {"Step_Index": OWN}),
    ),
    known=(
        *("Data_Point", "Date_Time", "DateTime", "Step_Time(s)", "Step_Time", "Cycle_Index"),
        *("Charge_Energy(Wh)", "Discharge_Energy(Wh)", "Charge_Energy", "Discharge_Energy"),
        *("dV/dt(V/s)", "dV/dt", "dQ/dV(Ah/V)", "dV/dQ(V/Ah)", "Power(W)", "Test_ID"),
        *("Internal_Resistance(Ohm)", "Internal_Resistance", "Internal_Resistance(Ohms)"),
        *("Is_FC_Data", "AC_Impedance(Ohm)", "AC_Impedance", "AC_Impedance(Ohms)"),
        *("ACI_Phase_Angle(Deg)", "ACI_Phase_Angle", "ACR(Ohm)", "ACR(Ohms)", "Unnamed: 0"),
        *(f"TC_Counter{k}" for k in range(1, 5)),
        *(f"Aux_Voltage_{k}(V)" for k in range(1, 9)),
    ),
    read=read_csv,
    sign="charge-positive",
)
