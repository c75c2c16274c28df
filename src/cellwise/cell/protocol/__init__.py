"""CC/CV protocols run on the cell's own equations, to design tests."""

from cellwise.cell.protocol.runner import SensorNoise, run_protocol
from cellwise.cell.protocol.steps import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    Step,
    capacity_test,
    hppc_test,
    repeat,
)

__all__ = [
    "ConstantCurrent",
    "ConstantVoltage",
    "DriveProfile",
    "Rest",
    "SensorNoise",
    "Step",
    "capacity_test",
    "hppc_test",
    "repeat",
    "run_protocol",
]
