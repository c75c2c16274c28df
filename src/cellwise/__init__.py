"""Battery cells: identify a model from laboratory tests, simulate it, estimate SOC online."""

from __future__ import annotations

TYPE_CHECKING = False  # `typing` takes longer than all that stands here
if TYPE_CHECKING:
    from typing import Any

    from cellwise.fit.pauses import simulate as simulate
    from cellwise.cell.metrics import ErrorMetrics as ErrorMetrics
    from cellwise.cell.model import CellModel as CellModel
    from cellwise.cell.model_error import ModelError as ModelError
    from cellwise.cell.model_file import read_model as read_model, write_model as write_model
    from cellwise.cell.plausibility.validity import Validity as Validity
    from cellwise.cell.simulate import Simulation as Simulation
    from cellwise.data import list_datasets as list_datasets, load_dataset as load_dataset
    from cellwise.diagnose import Diagnosis as Diagnosis, diagnose as diagnose
    from cellwise.errors import InputError as InputError
    from cellwise.estimate.adaptive import Adaptive as Adaptive
    from cellwise.estimate.filters.coulomb import Coulomb as Coulomb
    from cellwise.estimate.filters.kalman import Ekf as Ekf, SigmaPoints as SigmaPoints, Ukf as Ukf
    from cellwise.estimate.lockstep import LockstepEkf as LockstepEkf
    from cellwise.estimate.noise import Noise as Noise
    from cellwise.estimate.power.limits import OperatingLimits as OperatingLimits
    from cellwise.estimate.power.state_of_power import (
        power_limits as power_limits,
        power_settings as power_settings,
    )
    from cellwise.estimate.replay import Replay as Replay, replay as replay
    from cellwise.estimate.status import Status as Status
    from cellwise.estimate.tune_noise import tune_noise as tune_noise
    from cellwise.forecast import forecast as forecast
    from cellwise.identify import (
        Identification as Identification,
        IdentifySettings as IdentifySettings,
        TestLogs as TestLogs,
        identify_cell as identify_cell,
    )
    from cellwise.logs import (
        CellLog as CellLog,
        Stated as Stated,
        inspect_log as inspect_log,
        read_log as read_log,
        write_log as write_log,
    )
    from cellwise.logs.cell_log import resample as resample
    from cellwise.progress import progress_bar as progress_bar

# Loaded on first use: importing cellwise must not wait for compilers.
_NAMES = {
    "cellwise.fit.pauses": "simulate",
    "cellwise.cell.metrics": "ErrorMetrics",
    "cellwise.cell.model": "CellModel",
    "cellwise.cell.model_error": "ModelError",
    "cellwise.cell.model_file": "read_model write_model",
    "cellwise.cell.plausibility.validity": "Validity",
    "cellwise.cell.simulate": "Simulation",
    "cellwise.data": "list_datasets load_dataset",
    "cellwise.diagnose": "Diagnosis diagnose",
    "cellwise.errors": "InputError",
    "cellwise.estimate.adaptive": "Adaptive",
    "cellwise.estimate.filters.coulomb": "Coulomb",
    "cellwise.estimate.filters.kalman": "Ekf SigmaPoints Ukf",
    "cellwise.estimate.lockstep": "LockstepEkf",
    "cellwise.estimate.noise": "Noise",
    "cellwise.estimate.power.limits": "OperatingLimits",
    "cellwise.estimate.power.state_of_power": "power_limits power_settings",
    "cellwise.estimate.replay": "Replay replay",
    "cellwise.estimate.status": "Status",
    "cellwise.estimate.tune_noise": "tune_noise",
    "cellwise.forecast": "forecast",
    "cellwise.identify": "Identification IdentifySettings TestLogs identify_cell",
    "cellwise.logs": "CellLog Stated inspect_log read_log write_log",
    "cellwise.logs.cell_log": "resample",
    "cellwise.progress": "progress_bar",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES, key=lambda name: (name[0].islower(), name))


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module 'cellwise' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
