"""Every mechanism of a filter that decides something, and what has to be set so that it is off.

A switch sets fields of the filters' own records, or constants and functions of a kernel before it
is compiled: nothing of it is in the kernels, and nothing costs time where it is not asked for.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, field
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity_kernels import EVERYWHERE, ValidityScalars

ESTIMATE = "cellwise.estimate"
START = f"{ESTIMATE}.filters.predict_kernels"
BANK = f"{ESTIMATE}.equations.bank"
AGAIN = f"{ESTIMATE}.filters.bank_kernels"
OFFSET = f"{ESTIMATE}.equations.offset"
NEVER = 10**9


@dataclass(frozen=True)
class Switch:
    """What is off: fields of ``Noise`` and of ``AdaptiveSettings``, names within modules."""

    name: str
    noise: dict[str, float] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    names: tuple[tuple[str, str, Any], ...] = ()

    def throw(self) -> None:
        """Set the names; before any kernel is compiled."""
        for module, name, value in self.names:
            found = importlib.import_module(module)
            if not hasattr(found, name):
                raise AttributeError(f"{module} has no {name}: the switch '{self.name}' is stale")
            setattr(found, name, value)


def valid_everywhere(model: CellModel) -> ValidityScalars:
    """In place of a model's validity."""
    return EVERYWHERE


SWITCHES = (
    Switch("nothing"),
    Switch("memory that grows", noise={"slow_first_s": 1e9}),
    Switch("mismatch", noise={"mismatch_cap": 0.0}),
    Switch("persistent", noise={"lasting_share": 0.0}),
    Switch("contradicted", names=((f"{ESTIMATE}.evidence_kernels", "CONTRADICTED_S", math.inf),)),
    Switch("chords", names=((f"{ESTIMATE}.slopes_kernels", "WIDE_VARIANCE", math.inf),)),
    Switch(
        "components for a start",
        names=((BANK, "WIDE_VARIANCE", math.inf), (AGAIN, "SPREAD_VARIANCE", math.inf)),
    ),
    Switch("what a load has left before the start", names=((BANK, "LOOKS", 0),)),
    Switch("hypothesis of an offset, contradicted", noise={"offset_share": 0.0}),
    Switch(
        "hypothesis of an offset",
        names=(
            (f"{ESTIMATE}.filters.offset_kernels", "CHANCE", 0.0),
            (OFFSET, "ODDS", 0.0),
            (f"{ESTIMATE}.noise", "WANDERS", 1.0),
        ),
    ),
    Switch(
        "a rest shows the hypothesis its offset",
        names=((OFFSET, "REST_SHOWS", 0.0),),
    ),
    Switch("gate and recovery", noise={"gate": 1e6}),
    Switch("recovery", noise={"recovery_after": NEVER}),
    Switch("first rest", names=((f"{ESTIMATE}.evidence_kernels", "REST_RATE", 0.0),)),
    Switch(
        "start branches",
        names=(
            (f"{ESTIMATE}.equations.start", "START_LOAD_SHARE", 0.0),
            (START, "START_LOAD_RATE", 0.0),
            (START, "START_REST_RATE", 0.0),
        ),
    ),
    Switch("error along the SOC", noise={"ocv_soc": 0.0}),
    Switch(
        "wider beyond the data",
        names=((f"{ESTIMATE}.noise", "validity_scalars", valid_everywhere),),
    ),
    Switch("share of the resistances", noise={"branch_share": 0.0}),
    Switch("resistances free", settings={"learn": ("current_offset", "capacity")}),
    Switch("offset free", settings={"learn": ("resistance", "capacity")}),
    Switch("capacity free", settings={"learn": ("current_offset", "resistance")}),
    Switch("held until settled", settings={"settled_soc": 10.0}),
    Switch("a capacity needs more evidence", settings={"charge_probability": 0.2}),
)


def switch_of(name: str) -> Switch:
    """By its name."""
    return next(s for s in SWITCHES if s.name == name)
