"""What a person should know of a fit: where logs begin, what they do not show, what was assumed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import RANGE_V
from cellwise.cell.posterior import POINTS, Posterior
from cellwise.fit.log_starts import TRIALS
from cellwise.identify.checked_logs import CheckedLogs
from cellwise.identify.identification import OwnLog
from cellwise.logs.gaps import runs_of
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray
from cellwise.wording import Option


class Said(NamedTuple):
    """From where on something is said.

    Parameters
    ----------
    unseen : float      of an OCV's deviation before the logs: what they left says nothing there
    poor_V : float      half of a log's rows further off are another kind of cell's: 5 points of SOC
                        over a range of 1 V; right kinds leave 1 to 32 mV from 40 to -20 degC
    """

    unseen: float = 0.7
    poor_V: float = 0.05


SAID = Said()


def fit_notices(posterior: Posterior, checked: CheckedLogs) -> tuple[Notice, ...]:
    """What of the model is the prior's."""
    return (*_unseen(posterior), *_assumed(checked))


def start_notices(own: Sequence[OwnLog]) -> list[Notice]:
    """Where logs of the fit begin that nobody states the start of; tests where they are not full.

    The fit's own deviation knows the model that it made to be right; this one the model's error.
    """
    found = []
    for one in own:
        log, start = one.simulation.log, one.start
        full = one.role in ("ocv", "capacity") and start.soc > 1.0 - 2.0 * TRIALS.full_std
        if one.used and log.soc0 is None and not full:
            at = f"{start.soc:.3f} +- {2.0 * start.std:.3f}"
            text = f" begins at SOC {at} by its voltages"
            found.append(Notice(Code.START_FOUND, text, log=log.name))
    return found


def poor_fit(own: Sequence[OwnLog]) -> list[Notice]:
    """Said first: the finished model is typically far from a log of the fit, the one furthest."""
    used = [o for o in own if o.used]
    typical = [float(np.nanmedian(np.abs(o.compared_V))) for o in used]
    worst = int(np.argmax(typical))
    if not typical[worst] > SAID.poor_V:
        return []
    log = used[worst].simulation.log
    text = (
        f"the model DOES NOT FIT: typically {1e3 * typical[worst]:.0f} mV off '{log.name}': "
        "another kind of cell, number of cells in series ("
    )
    end = ") or unit?" if log.soc0 is None else "), unit or stated start?"
    said = (text, Option("series", letter="N"), end)
    return [Notice(Code.DOES_NOT_FIT, said, size_V=RANGE_V)]


def _unseen(posterior: Posterior) -> list[Notice]:
    """Where the OCV is known no better than before the logs."""
    before_V = np.linalg.norm(posterior.ocv_V, axis=0)
    stretches = _stretches(posterior.ocv_std_V > SAID.unseen * before_V)
    if not stretches:
        return []
    listed = " and ".join(f"{low:.2f} to {high:.2f}" for low, high in stretches)
    text = f"the logs say hardly anything of the OCV at SOC {listed}: there it is the prior's"
    return [Notice(Code.OCV_OF_PRIOR, f"{text} ({posterior.prior}), with its spread as error")]


def _assumed(checked: CheckedLogs) -> list[Notice]:
    """That nobody measured or stated the temperature of some loads, and what is taken for it."""
    tests = checked.tests
    loads = (*tests.hppc, *tests.drive)
    known = [warm is not None or log.temperature_C is not None for log, warm in loads]
    if all(known):
        return []
    some = "of some logs " if any(known) else ""
    text = f"no temperature {some}was measured: {checked.default_C:.0f} degC is assumed"
    stated = Option("temperature_C")
    return [Notice(Code.TEMPERATURE_ASSUMED, f"{text} (LOG@10 states another)", option=stated)]


def _stretches(inside: BoolArray) -> list[tuple[float, float]]:
    """Runs of at least two points of an even SOC grid, as lowest and highest."""
    grid = np.linspace(0.0, 1.0, POINTS)
    return [(float(grid[a]), float(grid[b])) for a, b in runs_of(inside) if b > a]
