"""What may be wrong with what a filter sees: sensors, samples, and the capacity in its model.

A fault never touches the truth: the reference is the tester's own counter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.logs.cell_log import CellLog
from cellwise.records import check_ranges, within
from cellwise.typing import FloatArray

NONE = "none"


@dataclass(frozen=True)
class Fault:
    """One fault, or several at once; the defaults are none.

    Parameters
    ----------
    name : str
    current_offset_C : float      added to the current, as a share of 1C
    current_offset_A : float      added to the current [A]
    current_gain : float          factor on the current
    voltage_offset_V : float      added to the voltage [V]
    current_noise_C, voltage_noise_V : float    white noise, standard deviations
    voltage_lag_samples : int     the voltage of a row is that of so many rows before
    current_resolution_A, voltage_resolution_V : float    of the last digit, 0: none
    current_range_A : float       no current reads as more
    dropout_share : float         share of the samples that are missing
    dropout_s : float             length of each drop-out [s]
    temperature_K : float         added to the temperature
    capacity : float              factor on the capacity that the filter's model states
    chemistry : str               only cells of this chemistry have it; empty: all
    """

    name: str
    current_offset_C: float = 0.0
    current_offset_A: float = 0.0
    current_gain: float = 1.0
    voltage_offset_V: float = 0.0
    current_noise_C: float = within(0.0, 1e9, 0.0)
    voltage_noise_V: float = within(0.0, 1e9, 0.0)
    voltage_lag_samples: int = within(0, 1e9, 0)
    current_resolution_A: float = within(0.0, 1e9, 0.0)
    voltage_resolution_V: float = within(0.0, 1e9, 0.0)
    current_range_A: float = within(0.0, 1e9, 1e9)
    dropout_share: float = within(0.0, 0.9, 0.0)
    dropout_s: float = within(1e-3, 1e9, 5.0)
    temperature_K: float = 0.0
    capacity: float = within(0.1, 1e9, 1.0)
    chemistry: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, f"fault '{self.name}'")


def _standard() -> tuple[Fault, ...]:
    found = []
    for share in (0.005, -0.005, 0.03, -0.03):
        found.append(Fault(f"offset {100 * share:+g} % of 1C", current_offset_C=share))
    for share in (0.01, -0.01, 0.03, -0.03):
        found.append(Fault(f"gain {100 * share:+g} %", current_gain=1.0 + share))
    for volt in (0.005, -0.005):
        found.append(Fault(f"voltage {1e3 * volt:+g} mV", voltage_offset_V=volt))
    return (
        *found,
        Fault("noise", current_noise_C=0.01, voltage_noise_V=0.005),
        Fault("voltage one sample late", voltage_lag_samples=1),
        Fault("drop-outs", dropout_share=0.05),
        Fault("temperature +3 K", temperature_K=3.0),
        Fault("temperature -3 K", temperature_K=-3.0),
        Fault("capacity -10 %", capacity=0.9),
    )


STANDARD = _standard()
# What an offset of the voltage means where the OCV is flat.
LFP = tuple(
    Fault(f"voltage {1e3 * v:+g} mV", voltage_offset_V=v, chemistry="LFP") for v in (0.030, -0.030)
)
GROUPS = {"standard": STANDARD, "lfp": LFP}
FAULTS = {fault.name: fault for fault in (Fault(NONE), *STANDARD, *LFP)}


def applies(fault: Fault, chemistry: str, log: CellLog) -> bool:
    """Whether a log of a cell can have the fault.

    A temperature that is not measured cannot be wrong; some faults are asked of one chemistry.
    """
    if fault.temperature_K and log.temperature_C is None:
        return False
    return fault.chemistry.casefold() in chemistry.casefold()


def faulty_log(fault: Fault, log: CellLog, capacity_Ah: float, rng: np.random.Generator) -> CellLog:
    """The log as a filter with these sensors sees it; the counter stays as it was.

    Parameters
    ----------
    capacity_Ah : float      of the true cell, for shares of 1C
    rng : Generator          of noise and drop-outs
    """
    if fault.name == NONE:
        return log
    rows = len(log)
    current = np.array(log.current_A) * fault.current_gain
    current += fault.current_offset_A + fault.current_offset_C * capacity_Ah
    voltage = np.array(log.voltage_V) + fault.voltage_offset_V
    if fault.voltage_lag_samples:
        lag = min(fault.voltage_lag_samples, rows - 1)
        voltage = np.concatenate((np.full(lag, voltage[0]), voltage[: rows - lag]))
    if fault.current_noise_C:
        current += fault.current_noise_C * capacity_Ah * rng.standard_normal(rows)
    if fault.voltage_noise_V:
        voltage += fault.voltage_noise_V * rng.standard_normal(rows)
    current = np.clip(current, -fault.current_range_A, fault.current_range_A)
    current = _rounded(current, fault.current_resolution_A)
    voltage = _rounded(voltage, fault.voltage_resolution_V)
    if fault.dropout_share:
        current[_dropped(fault, log.time_s, rng)] = np.nan
        voltage[_dropped(fault, log.time_s, rng)] = np.nan
    temperature = log.temperature_C
    if temperature is not None and fault.temperature_K:
        temperature = temperature + fault.temperature_K
    return replace(log, current_A=current, voltage_V=voltage, temperature_C=temperature)


def _rounded(values: FloatArray, resolution: float) -> FloatArray:
    return np.asarray(resolution * np.round(values / resolution)) if resolution else values


def faulty_model(fault: Fault, model: CellModel) -> CellModel:
    """The model that the filter is given."""
    if fault.capacity == 1.0:
        return model
    return replace(model, capacity_Ah=fault.capacity * model.capacity_Ah)


def _dropped(fault: Fault, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Rows that are missing, in stretches of ``dropout_s``; the first row is always there."""
    start = float(time_s[0])
    stretches = max(int(np.ceil((time_s[-1] - start) / fault.dropout_s)), 1)
    gone = rng.random(stretches) < fault.dropout_share
    which = np.minimum(((time_s - start) / fault.dropout_s).astype(int), stretches - 1)
    rows = np.flatnonzero(gone[which])
    return np.asarray(rows[rows > 0])
