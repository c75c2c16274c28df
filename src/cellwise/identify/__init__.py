"""Offline: laboratory tests to a CellModel."""

from cellwise.identify.identification import CellTests, Identification, IdentifySettings
from cellwise.identify.pipeline import identify_cell

__all__ = ["CellTests", "Identification", "IdentifySettings", "identify_cell"]
