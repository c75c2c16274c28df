"""Battery cells: identify a model from laboratory tests, simulate it, estimate SOC online."""

from __future__ import annotations

TYPE_CHECKING = False  # `typing` takes longer than all that stands here
if TYPE_CHECKING:
    from typing import Any

    from cellwise.cell.initial_soc.pauses import simulate
    from cellwise.cell.metrics import ErrorMetrics
    from cellwise.cell.model import CellModel
    from cellwise.cell.model_error import ModelError
    from cellwise.cell.model_file import read_model, write_model
    from cellwise.cell.plausibility.validity import Validity
    from cellwise.cell.simulate import Simulation
    from cellwise.data import list_datasets, load_dataset
    from cellwise.diagnose import Diagnosis, diagnose
    from cellwise.errors import InputError
    from cellwise.estimate.adaptive.adaptive import Adaptive
    from cellwise.estimate.filters.coulomb import Coulomb
    from cellwise.estimate.filters.kalman import Ekf, SigmaPoints, Ukf
    from cellwise.estimate.lockstep import LockstepEkf
    from cellwise.estimate.noise import Noise
    from cellwise.estimate.power.limits import OperatingLimits
    from cellwise.estimate.power.state_of_power import power_limits, power_settings
    from cellwise.estimate.replay import Replay, replay
    from cellwise.estimate.status import Status
    from cellwise.estimate.tune_noise import tune_noise
    from cellwise.forecast import forecast
    from cellwise.identify import Identification, IdentifySettings, TestLogs, identify_cell
    from cellwise.logs import CellLog, Stated, inspect_log, read_log, write_log
    from cellwise.logs.cell_log import resample
    from cellwise.progress import progress_bar

# Loaded on first use: importing cellwise must not wait for compilers.
_HOMES = {
    "CellLog": "cellwise.logs",
    "Stated": "cellwise.logs",
    "inspect_log": "cellwise.logs",
    "read_log": "cellwise.logs",
    "write_log": "cellwise.logs",
    "CellModel": "cellwise.cell.model",
    "ModelError": "cellwise.cell.model_error",
    "read_model": "cellwise.cell.model_file",
    "write_model": "cellwise.cell.model_file",
    "Validity": "cellwise.cell.plausibility.validity",
    "ErrorMetrics": "cellwise.cell.metrics",
    "Simulation": "cellwise.cell.simulate",
    "simulate": "cellwise.cell.initial_soc.pauses",
    "Identification": "cellwise.identify",
    "IdentifySettings": "cellwise.identify",
    "TestLogs": "cellwise.identify",
    "identify_cell": "cellwise.identify",
    "Diagnosis": "cellwise.diagnose",
    "diagnose": "cellwise.diagnose",
    "Adaptive": "cellwise.estimate.adaptive.adaptive",
    "forecast": "cellwise.forecast",
    "progress_bar": "cellwise.progress",
    "resample": "cellwise.logs.cell_log",
    "tune_noise": "cellwise.estimate.tune_noise",
    "Coulomb": "cellwise.estimate.filters.coulomb",
    "Ekf": "cellwise.estimate.filters.kalman",
    "LockstepEkf": "cellwise.estimate.lockstep",
    "Noise": "cellwise.estimate.noise",
    "OperatingLimits": "cellwise.estimate.power.limits",
    "power_limits": "cellwise.estimate.power.state_of_power",
    "power_settings": "cellwise.estimate.power.state_of_power",
    "Replay": "cellwise.estimate.replay",
    "replay": "cellwise.estimate.replay",
    "Status": "cellwise.estimate.status",
    "SigmaPoints": "cellwise.estimate.filters.kalman",
    "Ukf": "cellwise.estimate.filters.kalman",
    "list_datasets": "cellwise.data",
    "load_dataset": "cellwise.data",
    "InputError": "cellwise.errors",
}

__all__ = [
    "Adaptive",
    "CellLog",
    "CellModel",
    "Coulomb",
    "Diagnosis",
    "Ekf",
    "ErrorMetrics",
    "Identification",
    "IdentifySettings",
    "InputError",
    "LockstepEkf",
    "ModelError",
    "Noise",
    "OperatingLimits",
    "Replay",
    "SigmaPoints",
    "Simulation",
    "Stated",
    "Status",
    "TestLogs",
    "Ukf",
    "Validity",
    "diagnose",
    "forecast",
    "identify_cell",
    "inspect_log",
    "list_datasets",
    "load_dataset",
    "power_limits",
    "power_settings",
    "progress_bar",
    "read_log",
    "read_model",
    "replay",
    "resample",
    "simulate",
    "tune_noise",
    "write_log",
    "write_model",
]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'cellwise' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
