"""Battery cells: identify a model from laboratory tests, simulate it, estimate SOC online."""

from __future__ import annotations

TYPE_CHECKING = False  # `typing` takes longer than all that stands here
if TYPE_CHECKING:
    from typing import Any

    from cellwise.cell.initial_soc.gaps import simulate as simulate
    from cellwise.cell.metrics import ErrorMetrics as ErrorMetrics
    from cellwise.cell.model import CellModel as CellModel
    from cellwise.cell.model_error import ModelError as ModelError
    from cellwise.cell.model_file import read_model as read_model, write_model as write_model
    from cellwise.cell.plausibility.validity import Validity as Validity
    from cellwise.cell.simulate import Simulation as Simulation
    from cellwise.cell.stock import named_model as named_model, stock_model as stock_model
    from cellwise.data import list_datasets as list_datasets, load_dataset as load_dataset
    from cellwise.diagnose import Diagnosis as Diagnosis, diagnose as diagnose
    from cellwise.errors import InputError as InputError
    from cellwise.estimate.adaptive import Adaptive as Adaptive
    from cellwise.estimate.estimators import FilterOutput as FilterOutput
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
    from cellwise.estimate.trace import Trace as Trace
    from cellwise.estimate.tune_noise import tune_noise as tune_noise
    from cellwise.export.package import export_firmware as export_firmware
    from cellwise.forecast import forecast as forecast
    from cellwise.forecast.remaining import (
        ForecastTrace as ForecastTrace,
        Forecast as Forecast,
        forecast_at as forecast_at,
    )
    from cellwise.history.ageing import (
        AgeingHistory as AgeingHistory,
        ageing_history as ageing_history,
    )
    from cellwise.identify import (
        Identification as Identification,
        IdentifySettings as IdentifySettings,
        CellTests as CellTests,
        identify_cell as identify_cell,
    )
    from cellwise.live import LiveFilter as LiveFilter, Sample as Sample
    from cellwise.logs import (
        CellLog as CellLog,
        Stated as Stated,
        inspect_log as inspect_log,
        read_log as read_log,
        write_log as write_log,
    )
    from cellwise.logs.cell_log import resample as resample
    from cellwise.logs.reading import read_pack as read_pack
    from cellwise.notices import Code as Code, Notice as Notice, Severity as Severity
    from cellwise.pack.pack_estimate import (
        PackEstimate as PackEstimate,
        estimate_pack as estimate_pack,
    )
    from cellwise.progress import progress_bar as progress_bar
    from cellwise.report.diagnosis.page import diagnose_page as diagnose_page
    from cellwise.report.history_page import history_page as history_page
    from cellwise.report.identification.page import identify_page as identify_page
    from cellwise.report.pack_page import pack_page as pack_page
    from cellwise.report.replay.page import replay_page as replay_page
    from cellwise.workflows.replaying import replay_and_forecast as replay_and_forecast

    __version__: str

# Loaded on first use: importing cellwise must not wait for compilers.
_NAMES = {
    "cellwise.cell.initial_soc.gaps": "simulate",
    "cellwise.cell.metrics": "ErrorMetrics",
    "cellwise.cell.model": "CellModel",
    "cellwise.cell.model_error": "ModelError",
    "cellwise.cell.model_file": "read_model write_model",
    "cellwise.cell.plausibility.validity": "Validity",
    "cellwise.cell.simulate": "Simulation",
    "cellwise.cell.stock": "named_model stock_model",
    "cellwise.data": "list_datasets load_dataset",
    "cellwise.diagnose": "Diagnosis diagnose",
    "cellwise.errors": "InputError",
    "cellwise.estimate.adaptive": "Adaptive",
    "cellwise.estimate.estimators": "FilterOutput",
    "cellwise.estimate.filters.coulomb": "Coulomb",
    "cellwise.estimate.filters.kalman": "Ekf SigmaPoints Ukf",
    "cellwise.estimate.lockstep": "LockstepEkf",
    "cellwise.estimate.noise": "Noise",
    "cellwise.estimate.power.limits": "OperatingLimits",
    "cellwise.estimate.power.state_of_power": "power_limits power_settings",
    "cellwise.estimate.replay": "Replay replay",
    "cellwise.estimate.status": "Status",
    "cellwise.estimate.trace": "Trace",
    "cellwise.estimate.tune_noise": "tune_noise",
    "cellwise.export.package": "export_firmware",
    "cellwise.forecast": "forecast",
    "cellwise.forecast.remaining": "Forecast ForecastTrace forecast_at",
    "cellwise.history.ageing": "AgeingHistory ageing_history",
    "cellwise.identify": "Identification IdentifySettings CellTests identify_cell",
    "cellwise.live": "LiveFilter Sample",
    "cellwise.logs": "CellLog Stated inspect_log read_log write_log",
    "cellwise.logs.cell_log": "resample",
    "cellwise.logs.reading": "read_pack",
    "cellwise.notices": "Code Notice Severity",
    "cellwise.pack.pack_estimate": "PackEstimate estimate_pack",
    "cellwise.progress": "progress_bar",
    "cellwise.report.diagnosis.page": "diagnose_page",
    "cellwise.report.history_page": "history_page",
    "cellwise.report.identification.page": "identify_page",
    "cellwise.report.pack_page": "pack_page",
    "cellwise.report.replay.page": "replay_page",
    "cellwise.workflows.replaying": "replay_and_forecast",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES, key=lambda name: (name[0].islower(), name))


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "__version__":
        return import_module("importlib.metadata").version("cellwise")
    if name not in _HOMES:
        raise AttributeError(f"module 'cellwise' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
