"""CC/CV protocols run on the cell's own equations, to design tests."""

from cellwise.cell.protocol.runner import run_protocol
from cellwise.cell.protocol.steps import ConstantCurrent, ConstantVoltage, DriveProfile, Rest, Step

__all__ = ["ConstantCurrent", "ConstantVoltage", "DriveProfile", "Rest", "Step", "run_protocol"]
