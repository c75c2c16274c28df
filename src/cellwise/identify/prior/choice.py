"""Which prior: the one that was named, else the stock model whose window and curve fit the logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.stock.catalogue import stock_model, stock_names
from cellwise.errors import InputError
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.prior.update import PriorLog, update
from cellwise.logs.cell_log import CellLog


class Choice(NamedTuple):
    """When a stock model may be the prior, and when one of several is chosen.

    Parameters
    ----------
    over_V, under_V : float   beyond its window: charging pulses, and the load in the cold
    tail : float              per cent of the rows that may be anywhere
    logs : int                that the choice is made on, those that move most
    undecided : float         in log likelihood: twenty times as probable
    other_soc : float         two priors that see the cell this far apart are no matter of taste
    """

    over_V: float = 0.1
    under_V: float = 0.3
    tail: float = 1.0
    logs: int = 3
    undecided: float = 3.0
    other_soc: float = 0.15


LIMITS = Choice()


@dataclass(frozen=True, eq=False)
class Candidate:
    """A stock model fitted to the logs, and how badly: minus its log probability."""

    name: str
    misfit: float
    soc0: float


def in_window(name: str, logs: Sequence[CellLog]) -> bool:
    """Whether a stock model's voltage window holds the logs."""
    model = stock_model(name)
    if model.voltage_min_V is None or model.voltage_max_V is None:
        return False
    lows = [float(np.nanpercentile(log.voltage_V, LIMITS.tail)) for log in logs]
    highs = [float(np.nanpercentile(log.voltage_V, 100.0 - LIMITS.tail)) for log in logs]
    return (
        min(lows) > model.voltage_min_V - LIMITS.under_V
        and max(highs) < model.voltage_max_V + LIMITS.over_V
    )


def choose_prior(
    logs: Sequence[CellLog],
    corrections_of: Callable[[CellModel], Corrections],
    prepared: Callable[[Corrections], Sequence[PriorLog]],
) -> tuple[CellModel, str]:
    """The most probable stock model for a cell of which only drives are known, and why.

    Parameters
    ----------
    logs : sequence of CellLog
    corrections_of : callable     the corrections of a prior
    prepared : callable           the logs with their starts by that prior

    Returns
    -------
    CellModel, str      the prior, and a notice of what it was chosen from

    Raises
    ------
    InputError        no window holds the logs; several kinds of cell explain them as well and see
                      the cell at another SOC
    """
    names = [name for name in stock_names() if in_window(name, logs)]
    low = min(float(np.nanmin(log.voltage_V)) for log in logs)
    high = max(float(np.nanmax(log.voltage_V)) for log in logs)
    between = f"voltages from {low:.2f} to {high:.2f} V"
    if not names:
        raise InputError(
            f"{between} that no stock model has, and too little of the SOC range for a model",
            f"a cell like one of {', '.join(stock_names())}",
            "Give `prior=MODEL` of such a cell, or a low-rate or pulse test of it.",
        )
    found = []
    for name in names:
        corrections = corrections_of(stock_model(name))
        items = sorted(
            prepared(corrections), key=lambda i: -float(np.ptp(i.log.counted_charge_Ah()))
        )
        one = update(corrections, items[: LIMITS.logs])
        found.append(Candidate(name, one.misfit, float(one.soc0[0])))
    found.sort(key=lambda c: c.misfit)
    best = found[0]
    close = [c for c in found[1:] if c.misfit - best.misfit < LIMITS.undecided]
    elsewhere = [c for c in close if abs(c.soc0 - best.soc0) > LIMITS.other_soc]
    if elsewhere:
        texts = ", ".join(f"{c.name} (SOC {c.soc0:.2f})" for c in (best, *elsewhere))
        raise InputError(
            f"{between} that several kinds of cell show alike: {texts}",
            "a log that shows which of them it is",
            "Give `prior=NAME` of the right kind.",
        )
    others = f"; {', '.join(c.name for c in close)} as probable" if close else ""
    return stock_model(best.name), (
        f"too little of the SOC range was seen for a model of its own: {best.name} is the prior, "
        f"chosen by its voltage window and fit of {', '.join(names)}{others}; "
        "`prior=NAME` names another"
    )
