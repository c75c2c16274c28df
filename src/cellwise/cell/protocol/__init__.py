"""CC/CV protocols run on the cell's own equations, to design tests."""

from cellwise.cell.protocol.runner import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    Step,
    run_protocol,
)

__all__ = ["ConstantCurrent", "ConstantVoltage", "DriveProfile", "Rest", "Step", "run_protocol"]
