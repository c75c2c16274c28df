"""Offline: laboratory tests to a CellModel."""

from cellwise.identify.identification import Identification, IdentifySettings, TestLogs
from cellwise.identify.pipeline import identify_cell

__all__ = ["Identification", "IdentifySettings", "TestLogs", "identify_cell"]
