"""Many logs on Dask: one row per log, in parts of parquet, resumable, errors as rows."""

from __future__ import annotations

from cellwise.fleet.engine import FleetResult, run_fleet
from cellwise.fleet.tasks import DiagnoseTask, HistoryTask, PackTask, ReplayTask

__all__ = ["DiagnoseTask", "FleetResult", "HistoryTask", "PackTask", "ReplayTask", "run_fleet"]
