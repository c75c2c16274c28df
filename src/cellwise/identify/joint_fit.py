"""Station: which logs take part in the fit, what is known of each beforehand, the fit itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Effect
from cellwise.cell.model import CellModel
from cellwise.cell.posterior import Posterior
from cellwise.cell.simulate import start_hysteresis
from cellwise.errors import InputError
from cellwise.fit.capacity import TRIED, at_open_capacity
from cellwise.fit.log_starts import TRIALS, Beginning, find_beginning
from cellwise.fit.population import CellPrior, ModelPrior, cell_classes, class_of, prior_of
from cellwise.fit.posterior import posterior_of
from cellwise.fit.problem import Problem
from cellwise.fit.rows import PAST_V, FitLog, PreparedLog
from cellwise.fit.solve import FitResult, fit_logs
from cellwise.fit.solver import Prior
from cellwise.fit.unknowns import FitSettings, Layout, layout_of
from cellwise.identify.assemble import fitted_model
from cellwise.identify.capacity.half_cycles import discharge_rows, find_half_cycles, join_logs
from cellwise.identify.checked_logs import CheckedLogs, grouped_by_temperature
from cellwise.identify.identification import REFERENCE_C, IdentifySettings, Start
from cellwise.identify.measured_capacity import SPREAD as CAPACITY_SPREAD
from cellwise.identify.measured_capacity import MeasuredCapacity
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray

QUICK_ROWS, QUICK_ITERATIONS = 800, 12  # compared rows of a log, where fits are compared


class Roles(NamedTuple):
    """What the role of a log says of it.

    Parameters
    ----------
    test_full, drive_full : float     how probable it is that a test of the capacity, a drive or a
                                      pulse test begins full, before its voltages are looked at
    open_std : float                  of a start that nobody knows [SOC]
    full_std, drive_std : float       of a full one, charged by a tester, by a charger
    rate_share : float                of the capacity that a test may give less for each C of its
                                      rate: what is missing beyond is another sample's or age's
    fewest_rows, least_moved : float  what says nothing: fewer rows, a smaller share of the capacity
    """

    test_full: float = 0.97
    drive_full: float = 0.9
    open_std: float = 0.3
    full_std: float = 0.0005
    drive_std: float = 0.004
    rate_share: float = 0.1
    fewest_rows: int = 10
    least_moved: float = 0.005


ROLES = Roles()


@dataclass(frozen=True, eq=False)
class JointLogs:
    """What the fit is made of: logs, from where, the class of the cell, which unknowns.

    ``starts`` holds every log that was given, ``logs`` those that take part, in the same order.
    """

    logs: tuple[FitLog, ...]
    starts: tuple[Start, ...]
    cells: CellPrior
    settings: FitSettings
    capacity_Ah: float
    reference_C: float
    grid_C: FloatArray
    notices: tuple[Notice, ...] = ()
    contradictions: tuple[Notice, ...] = ()

    def fit(
        self,
        logs: Sequence[FitLog],
        settings: FitSettings,
        common: FloatArray | None = None,
        *,
        quick: int = 0,
    ) -> FitResult:
        """Fit some logs, from what the unknowns were that all logs have in ``common``.

        Where fits are compared, in ``quick`` steps, with fewer rows.
        """
        layout, items = self._layout(settings, len(logs)), tuple(logs)
        prior = self._prior(settings, layout, items)
        theta = None
        if common is not None:
            theta = prior.mean.copy()
            theta[: layout.sample] = common[: layout.sample]
        return fit_logs(
            items, self.cells.base(), prior, layout, capacity_Ah=self.capacity_Ah,
            reference_C=self.reference_C, grid_C=self.grid_C, theta=theta,
            most_rows=QUICK_ROWS if quick else None, iterations=quick or 40,
        )  # fmt: skip

    def with_open_capacity(
        self, result: FitResult, logs: Sequence[FitLog], settings: FitSettings
    ) -> FitResult:
        """A fit at the capacity of the profile of its likelihood, where no test has shown it."""
        layout, items = result.layout, tuple(logs)
        if settings.ln_capacity_std < TRIED.measured:
            return result
        base, prior = self.cells.base(), self._prior(settings, layout, items)
        problem = Problem(items, base, prior, layout, self.capacity_Ah, self.grid_C,
                          self.reference_C, QUICK_ROWS)  # fmt: skip

        def again(held: Prior, theta: FloatArray) -> FitResult:
            return fit_logs(
                items, base, held, layout, capacity_Ah=self.capacity_Ah,
                reference_C=self.reference_C, grid_C=self.grid_C, theta=theta,
            )  # fmt: skip

        return at_open_capacity(problem, result, again)

    def residuals(
        self, result: FitResult, logs: Sequence[FitLog], settings: FitSettings
    ) -> list[tuple[PreparedLog, FloatArray]]:
        """What a fit leaves of logs that it has not seen [V]."""
        layout, items = self._layout(settings, len(logs)), tuple(logs)
        prior = self._prior(settings, layout, items)
        problem = Problem(items, self.cells.base(), prior, layout, self.capacity_Ah, self.grid_C,
                          self.reference_C, QUICK_ROWS)  # fmt: skip
        theta = prior.mean.copy()
        theta[: layout.sample] = result.theta[: layout.sample]
        return list(zip(problem.logs, problem.residuals(theta), strict=True))

    def _layout(self, settings: FitSettings, logs: int) -> Layout:
        return layout_of(settings.branches, settings.hysteresis, int(self.grid_C.size), logs)

    def _prior(self, settings: FitSettings, layout: Layout, logs: tuple[FitLog, ...]) -> Prior:
        return prior_of(
            self.cells, layout, logs, self.capacity_Ah, self.grid_C, self.reference_C, settings
        )

    def model_of(self, result: FitResult, effects: Sequence[Effect] = ()) -> CellModel:
        """The model of a fit, and effects that lie beside its tables."""
        hot = any(item.log.temperature_C is not None for item in self.logs)
        model = fitted_model(result, self.cells, self.settings.skew, hot)
        for effect in effects:
            model = model.with_effect(effect)
        return model

    def posterior(
        self, result: FitResult, logs: Sequence[FitLog], settings: FitSettings
    ) -> Posterior:
        """What the logs left open of the model."""
        prior = self._prior(settings, result.layout, tuple(logs))
        return posterior_of(result, prior, self.cells.said())

    def as_found(self, result: FitResult) -> tuple[FitLog, ...]:
        """The logs with starts and capacities as a fit has them, known from here on."""
        return tuple(
            replace(
                item,
                soc0=result.start(k)[0],
                soc0_std=0.0,
                ln_sample=float(result.theta[result.layout.sample + k]),
                sample_std=0.0,
            )
            for k, item in enumerate(self.logs)
        )

    @property
    def used(self) -> tuple[Start, ...]:
        """Where the logs that take part begin."""
        return tuple(s for s in self.starts if not s.left_out)


def gather_logs(
    checked: CheckedLogs,
    capacity: MeasuredCapacity,
    settings: IdentifySettings,
    say: Callable[[str], None],
) -> JointLogs:
    """Find what may be known of every log before the fit: class of the cell, starts.

    Raises
    ------
    InputError        no log that says anything
    """
    parts = grouped_by_temperature(checked.tests, checked.low_rate, checked.default_C)
    grid = np.array(sorted(parts))
    items, starts, roles, notices = [], [], [], []
    for temperature_C in grid:
        tests = parts[float(temperature_C)]
        several = [
            *(("hppc", log) for log, _ in tests.hppc),
            *(("drive", log) for log, _ in tests.drive),
            *(("ocv", log) for log in tests.ocv),
            *(("capacity", log) for log in tests.capacity),
        ]
        for role, log in several:
            item = _item(
                role, log, float(temperature_C), capacity.capacity_Ah, bool(checked.tests.ocv)
            )
            why = _says_nothing(log, capacity.capacity_Ah)
            if role == "ocv" and item.compare is not None and not item.compare.any():
                why = why or "it has no discharge"
            if why:
                starts.append(Start(log, 1.0 if log.soc0 is None else log.soc0, item.compare, why))
                text = f" left out of the fit: {why}"
                notices.append(Notice(Code.LOG_LEFT_OUT, text, log=log.name))
                continue
            items.append(item)
            roles.append(role)
            starts.append(Start(log, 1.0, item.compare, ""))
    if not items:
        raise InputError(
            starts[0].left_out + f" in log '{starts[0].log.name}'",
            f"at least {ROLES.fewest_rows} rows, and {ROLES.least_moved:.1%} of the capacity moved",
            "Give a longer log, or check its columns and the capacity of "
            f"{capacity.capacity_Ah:g} Ah (mAh for Ah?).",
        )
    say("starts")
    joint = partial(
        _joint_logs, tuple(items), tuple(roles), tuple(starts), tuple(notices), capacity, settings,
        scaled=bool(checked.tests.ocv),
    )  # fmt: skip
    known = settings.prior
    if known is not None and not known.is_stock:
        one = ModelPrior(known)
        return joint(one, one.grid_C)
    # A stock model is one cell of its class: by the evidence it would be preferred for its narrow
    # prior alone, and was for cells of another maker.
    return joint(_class_of(items, roles, capacity, settings), grid)


def _joint_logs(
    items: Sequence[FitLog],
    roles: Sequence[str],
    starts: Sequence[Start],
    notices: Sequence[Notice],
    capacity: MeasuredCapacity,
    settings: IdentifySettings,
    cells: CellPrior,
    grid_C: FloatArray,
    *,
    scaled: bool,
) -> JointLogs:
    """Logs with their starts by a prior; ``scaled``: a low-rate test says what full is."""
    logs = tuple(
        _begun(item, _begins(item, role, cells, capacity) if item.log.soc0 is None else None,
               role, scaled)
        for item, role in zip(items, roles, strict=True)
    )  # fmt: skip
    begins = iter(logs)
    fit = FitSettings(
        branches=settings.branches,
        hysteresis=cells.name == "lfp" if settings.hysteresis is None else settings.hysteresis,
        ln_capacity_std=capacity.ln_std,
        skew=any(item.skewed for item in logs),
    )
    return JointLogs(
        logs, tuple(s if s.left_out else s._replace(soc0=next(begins).soc0) for s in starts),
        cells, fit, capacity.capacity_Ah,
        float(grid_C[int(np.argmin(np.abs(grid_C - REFERENCE_C)))]), grid_C,
        tuple(notices),
    )  # fmt: skip


def _item(role: str, log: CellLog, at_C: float, capacity_Ah: float, scaled: bool) -> FitLog:
    """A log by its role; ``scaled``: a low-rate test says what the others' capacity is of."""
    if role in ("hppc", "drive"):
        return FitLog(log, 1.0, skewed=role == "drive", temperature_C=at_C)
    if role == "ocv":
        return FitLog(log, 1.0, compare=discharge_rows(log), temperature_C=at_C, low_rate=True)
    own_std = sample_std(log, capacity_Ah) if scaled else 0.0
    return FitLog(log, 1.0, temperature_C=at_C, sample_std=own_std)


def sample_std(log: CellLog, capacity_Ah: float) -> float:
    """Deviation beforehand of ln of what the cell of a capacity test holds over the others'.

    As large as what its charge has of more than they hold, or of less than its rate explains.
    """
    halves = find_half_cycles(join_logs(log))
    if not halves:
        return CAPACITY_SPREAD.pulses
    most = max(halves, key=lambda h: abs(h.charge_Ah))
    gives = float(np.log(abs(most.charge_Ah) / capacity_Ah))
    explained = ROLES.rate_share * abs(most.main_current_A) / capacity_Ah
    return float(np.hypot(CAPACITY_SPREAD.pulses, max(gives, -gives - explained, 0.0)))


def _says_nothing(log: CellLog, capacity_Ah: float) -> str:
    """Why a log is no use for a fit; empty for one that is."""
    rows = int(np.count_nonzero(np.isfinite(log.voltage_V)))
    if rows < ROLES.fewest_rows:
        return f"{rows} row(s) with a voltage"
    moved = float(np.abs(log.known_current_A()) @ log.interval_s) / 3600.0 / capacity_Ah
    return f"only {moved:.2%} of the capacity moved" if moved < ROLES.least_moved else ""


def _begins(item: FitLog, role: str, cells: CellPrior, capacity: MeasuredCapacity) -> Beginning:
    """Where a log of unknown start begins by itself."""
    test = role in ("ocv", "capacity")
    charged, rows = 0.0, discharge_rows(item.log)
    if test and rows.any():
        charged = float(item.log.counted_charge_Ah()[int(np.argmax(rows))])
    full = ROLES.test_full if test else ROLES.drive_full
    return find_beginning(
        item, cells, capacity.capacity_Ah, capacity.ln_std, item.temperature_C or REFERENCE_C,
        full, charged,
    )  # fmt: skip


def _class_of(
    items: Sequence[FitLog],
    roles: Sequence[str],
    capacity: MeasuredCapacity,
    settings: IdentifySettings,
) -> CellPrior:
    """The class of the cell: as stated, else the more probable one by the log that moves most."""
    classes = {c.name: c for c in cell_classes(frozenset(settings.without_lineage))}
    stated = class_of(settings.chemistry or (settings.prior.chemistry if settings.prior else ""))
    if stated:
        return classes[stated]
    most = max(range(len(items)), key=lambda k: float(np.ptp(items[k].log.counted_charge_Ah())))
    return max(
        classes.values(),
        key=lambda c: _begins(items[most], roles[most], c, capacity).ln_evidence,
    )


def _begun(item: FitLog, found: Beginning | None, role: str, scaled: bool) -> FitLog:
    """A log with its start: as stated, full, or open around the most probable.

    ``scaled``: a low-rate test beside it says what full is, and what the cell holds.
    """
    if found is None:
        soc0 = 1.0 if item.log.soc0 is None else item.log.soc0  # stated: else it was found
        past = 0.0 if soc0 > 0.99 else PAST_V
        return replace(
            item, soc0=soc0, soc0_std=ROLES.full_std, h0=start_hysteresis(soc0), past_V=past
        )
    if found.full > 0.5:
        # Full as a charger leaves it, or elsewhere as far as its voltages leave that open.
        full_std = ROLES.drive_std if role == "drive" else ROLES.full_std
        left_open = 0.0 if scaled else max(found.std**2 - TRIALS.full_std**2, 0.0)
        std = float(np.sqrt(full_std**2 + left_open))
        item = replace(item, soc0=found.soc, soc0_std=std)
        return replace(item, h0=start_hysteresis(found.soc))
    item = replace(item, soc0=found.soc, soc0_std=ROLES.open_std, past_V=PAST_V)
    return replace(item, h0=start_hysteresis(found.soc))
