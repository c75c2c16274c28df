"""A stream in, state out: samples as they come, from a pipe, a CAN bus or an autopilot.

A source yields :class:`Sample` (or :class:`Stray`, what could not be read, or None while nothing
comes); a :class:`LiveFilter` turns samples into :class:`Update`; :func:`run_live` joins the two.
"""

from __future__ import annotations

from cellwise.live.live_filter import LiveFilter, Update
from cellwise.live.run import Counts, run_live
from cellwise.live.samples import Sample, Stray
from cellwise.live.source import open_source

__all__ = ["Counts", "LiveFilter", "Sample", "Stray", "Update", "open_source", "run_live"]
