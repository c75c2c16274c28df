"""Measured logs: read, checked, inspected, written."""

from cellwise.logs.cell_log import CellLog, CurrentMeaning
from cellwise.logs.checks.sign import SignCheck, verify_sign
from cellwise.logs.formats import FORMATS
from cellwise.logs.gaps import Gap, find_gaps
from cellwise.logs.inspection import Inspection, inspect_log
from cellwise.logs.reading import read_log
from cellwise.logs.stated import Stated
from cellwise.logs.writing import write_log

__all__ = [
    "FORMATS",
    "CellLog",
    "CurrentMeaning",
    "Gap",
    "Inspection",
    "SignCheck",
    "Stated",
    "find_gaps",
    "inspect_log",
    "read_log",
    "verify_sign",
    "write_log",
]
