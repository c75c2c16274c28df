"""Columns of a fleet's results: the same in every part, whatever a log has or has not."""

from __future__ import annotations

from collections.abc import Mapping

BY_LOG, BY_MACHINE, BY_US = "log", "machine", "cellwise"  # whose fault a failure is

# Which log this is, and whether it is done; `log` is the path below the fleet's folder.
IDENTITY: Mapping[str, type] = {
    "log": str,
    "cell": str,
    "bytes": int,
    "modified_ns": int,
    "error": str,
    "failed_by": str,
    "seconds": float,
}
LOG: Mapping[str, type] = {
    "samples": int,
    "duration_s": float,
    "gaps": int,
    "format": str,
    "sign": str,
    "notices": str,
}
REPLAY: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    "estimator": str,
    "soc0": float,
    "soc0_std": float,
    "soc0_how": str,
    "soc_final": float,
    "soc_final_std": float,
    "soc_min": float,
    "soc_max": float,
    "soc_rmse": float,
    "soc_mae": float,
    "soc_max_error": float,
    "convergence_s": float,
    "settled_rmse": float,
    "coverage_2sigma": float,
    "nis_mean": float,
    "voltage_rmse_V": float,
    "rejected_share": float,
    "status": int,
    "ns_per_step": float,
    "offset_A": float,
    "offset_std_A": float,
    "capacity_Ah": float,
    "capacity_std_Ah": float,
    "resistance_scale": float,
    "soh_capacity": float,
    "soh_resistance": float,
}
DIAGNOSE: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    "verdict": str,
    "causes": str,
    "parameters": str,
    "gain": float,
    "gain_low": float,
    "gain_high": float,
    "rmse_before_V": float,
    "rmse_after_V": float,
    "next_test": str,
}
# Of a folder of logs: one pack's or one cell's, in order.
FOLDER: Mapping[str, type] = {
    **IDENTITY,
    "logs": int,
    "samples": int,
    "unread": str,
    "notices": str,
}
PACK: Mapping[str, type] = {
    **FOLDER,
    "cells": int,
    "soc_min": float,
    "soc_mean": float,
    "soc_max": float,
    "capacity_min_Ah": float,
    "capacity_mean_Ah": float,
    "capacity_std_Ah": float,
    "resistance_max": float,
    "usable_Ah": float,
    "usable_Wh": float,
    "left_Ah": float,
    "balancing_gain_Ah": float,
    "weakest_by_soc": str,
    "weakest_by_capacity": str,
    "weakest_by_resistance": str,
    "weak": str,
    "causes": str,
    "voltage_rmse_V": float,
}
HISTORY: Mapping[str, type] = {
    **FOLDER,
    "first_day": str,
    "last_day": str,
    "throughput_Ah": float,
    "capacity_share": float,
    "capacity_Ah": float,
    "capacity_std_Ah": float,
    "resistance_scale": float,
    "resistance_std": float,
    "knee": str,
    "next_reference": str,
}
