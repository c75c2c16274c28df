"""Every estimator by its name; its code is loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog

# Where each stands: baselines need filterpy, the firmware a C compiler and the room above this one.
HOMES = {
    "coulomb": "cellwise.estimate.filters.coulomb:Coulomb",
    "ekf": "cellwise.estimate.filters.kalman:Ekf",
    "ukf": "cellwise.estimate.filters.kalman:Ukf",
    "adaptive": "cellwise.estimate.adaptive:Adaptive",
    "rest-ocv": "cellwise.estimate.filters.coulomb:RestOcv",
    "fixed-step": "cellwise.estimate.fixed.fixed_step:FixedStep",
    "firmware": "cellwise.export.firmware:Firmware",
    "filterpy-ekf": "cellwise.estimate.filters.filterpy_filters:FilterpyEkf",
    "filterpy-ukf": "cellwise.estimate.filters.filterpy_filters:FilterpyUkf",
}
ESTIMATORS = tuple(HOMES)


class Estimator(Protocol):
    """Whatever can replay a log."""

    name: str

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Estimate over a whole log from an initial SOC and its standard deviation."""
        ...


def make_estimator(name: str, model: CellModel, noise: Noise | None = None) -> Estimator:
    """An estimator by its name in the command line.

    Raises
    ------
    InputError        a name that is not known
    """
    if name not in HOMES:
        raise InputError(
            f"estimator '{name}'", f"one of {', '.join(ESTIMATORS)}", "Choose one of them."
        )
    module, kind = HOMES[name].split(":")
    return cast(Estimator, getattr(import_module(module), kind)(model, noise))
