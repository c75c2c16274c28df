"""The two papers' tables: capacity, pulses, polynomials and error by capacity; error by rate.

The LFP040AHA paper identifies by single pulses and judges on a load profile. The NCR18650B paper
takes one characterization rate at a time and judges on its own current. Its equations (6) to (9)
can be read on the pulse or on the relaxation after it. On the pulse the OCV moves by 10 % of SOC
and counts as resistance; on the relaxation it stands still. On the embedded cell the first way
misses by some 90 mV and the second by 10 to 20 mV, the size of the errors that the paper prints.
Which one the paper took is therefore inferred, not known: both are shown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cellwise.cell.metrics import ErrorMetrics
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.identify.assemble import plain_model
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.hppc.pulse_quality import PulseQuality
from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.identification import Identification, IdentifySettings, TestLogs
from cellwise.identify.papers.log_linear_exp import LogLinearExp, fit_log_linear_exp
from cellwise.identify.papers.segments import SEGMENTS
from cellwise.identify.pipeline import Progress, identify_cell
from cellwise.identify.pulse_fit.fit_pulse import Method
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseParameters
from cellwise.identify.tables import cubic_fit, pulse_tables
from cellwise.logs.cell_log import CellLog

# The embedded cell whose numbers stand beside the published ones.
LFP_EMBEDDED = "LFP / graphite 26650, physics model, 2.3 Ah"
CHOICES = {
    "cc-average": "mean of CC parts",
    "cc-cv-average": "mean of CC + CV",
    "hppc-total": "HPPC total",
    "nominal": "nominal",
}
WINDOW_S = (300.0, 10_800.0)  # 5 to 180 min
# A branch with less than this share of R0 is none: its tau / R is a capacitance of nothing.
BRANCH_SHARE = 0.01
QUALITIES: tuple[PulseQuality, ...] = ("healthy", "trimmed", "distorted", "spurious")


@dataclass(frozen=True)
class TestPulses:
    """One test of the HPPC log: its net charge [Ah], and its short pulses by quality."""

    __test__ = False  # not a test class, whatever pytest thinks of its name

    number: int
    soc_start: float
    charge_Ah: float
    healthy: int
    trimmed: int
    distorted: int
    spurious: int


@dataclass(frozen=True)
class Polynomial:
    """a + b s + c s^2 + d s^3 of one parameter, in ohm or farad (equation 9)."""

    parameter: str
    a: float
    b: float
    c: float
    d: float


@dataclass(frozen=True)
class CycleError:
    """Voltage error over a load profile; shares are of the measured voltage."""

    rms_V: float
    mean_abs: float
    mean_abs_window: float
    peak: float
    peak_window: float


@dataclass(frozen=True)
class ChoiceError:
    """What one capacity choice leads to: by the paper's method, and by ours."""

    choice: str
    capacity_Ah: float
    paper: CycleError
    ours: CycleError


@dataclass(frozen=True)
class LfpTables:
    """All tables of the LFP paper."""

    capacities: tuple[CapacityRow, ...]
    tests: tuple[TestPulses, ...]
    ocv: LogLinearExp
    spline_rmse_V: float
    polynomials: tuple[Polynomial, ...]
    errors: tuple[ChoiceError, ...]
    method: Method

    @property
    def hppc_Ah(self) -> float:
        """Sum over the tests [Ah]: the paper's ``HPPC total``."""
        return sum(t.charge_Ah for t in self.tests)


def lfp_tables(
    hppc: CellLog,
    capacity: Sequence[CellLog],
    cycle: CellLog,
    nominal_Ah: float,
    *,
    method: Method = "pso",
    progress: Progress | None = None,
) -> LfpTables:
    """Identify the cell once for every capacity choice, by the paper's way and by ours.

    The paper's way: single pulses, equation 8 through the rests, cubic polynomials over SOC, no
    refinement.

    Parameters
    ----------
    hppc, capacity, cycle : CellLog    the HPPC log, the capacity tests, the charge-depleting cycle
    nominal_Ah : float
    method : str                       of the paper's way: ``pso`` is the paper's

    Raises
    ------
    InputError        as `identify_cell`
    """
    say = progress or (lambda _: None)
    tests = TestLogs(hppc=((hppc, None),), capacity=tuple(capacity))
    errors = []
    first: Identification | None = None
    for choice in CHOICES:
        say(f"LFP paper, capacity {CHOICES[choice]}: {method}, cubic polynomials")
        paper = identify_cell(
            tests,
            IdentifySettings(
                nominal_Ah=nominal_Ah,
                capacity_choice=choice,
                method=method,
                tables="cubic",
                refine=False,
            ),
        )
        ocv = fit_log_linear_exp(paper.ocv.points_soc, paper.ocv.points_V)
        if first is None:
            first, first_ocv = paper, ocv
        model = paper.model
        model = replace(model, ocv_V=np.tile(ocv.evaluate(model.soc), (len(model.ocv_V), 1)))
        say(f"LFP paper, capacity {CHOICES[choice]}: varpro, refined")
        ours = identify_cell(tests, IdentifySettings(nominal_Ah=nominal_Ah, capacity_choice=choice))
        errors.append(
            ChoiceError(
                choice,
                model.capacity_Ah,
                cycle_error(model, cycle),
                cycle_error(ours.model, cycle),
            )
        )
    if first is None:  # CHOICES is not empty
        raise AssertionError
    pulses = first.temperatures[0].pulse_sets[0]
    soc = pulses.anchor.soc - hppc.counted_charge_Ah() / first.model.capacity_Ah
    return LfpTables(
        capacities=capacity_table(usable_tests(first.capacity_tests)),
        tests=split_tests(hppc, pulses.pulses, soc),
        ocv=first_ocv,
        spline_rmse_V=_rms(first.ocv.points_V - first.ocv.function.evaluate(first.ocv.points_soc)),
        polynomials=polynomials(pulses.fits),
        errors=tuple(errors),
        method=method,
    )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def cycle_error(
    model: CellModel, log: CellLog, window_s: tuple[float, float] = WINDOW_S
) -> CycleError:
    """Error of a model from a full cell over a load profile, as the paper states it."""
    simulated = simulate(model, log, 1.0)
    error = simulated.error_V
    known = np.isfinite(error)
    share = np.abs(error[known]) / log.voltage_V[known]
    since = log.time_s[known] - log.time_s[0]
    inside = share[(since >= window_s[0]) & (since <= window_s[1])]
    return CycleError(
        rms_V=simulated.metrics.rmse_V,
        mean_abs=float(np.mean(share)),
        mean_abs_window=float(np.mean(inside)) if inside.size else float("nan"),
        peak=float(np.max(share)),
        peak_window=float(np.max(inside)) if inside.size else float("nan"),
    )


def split_tests(
    log: CellLog, pulses: Sequence[Pulse], soc: Sequence[float] | np.ndarray
) -> tuple[TestPulses, ...]:
    """The log's HPPC tests: each holds some short pulses and ends with a move to another SOC."""
    counted = log.counted_charge_Ah()
    ends = [p.stop - 1 for p in pulses if p.role == "move"]
    short = [p for p in pulses if p.role == "pulse"]
    if not ends or (short and short[-1].start > ends[-1]):
        ends.append(len(log) - 1)
    found = []
    for number, (begin, end) in enumerate(pairwise([0, *ends]), start=1):
        here = [p.quality for p in short if begin <= p.start <= end]
        count: dict[str, int] = {q: here.count(q) for q in QUALITIES}
        charge = float(counted[end] - counted[begin])
        found.append(TestPulses(number, float(soc[begin]), charge, **count))
    return tuple(found)


def polynomials(fits: Sequence[PulseFit]) -> tuple[Polynomial, ...]:
    """The paper's cubic polynomials of R0, R1, R2, C1, C2 through the fitted pulses."""
    tables = pulse_tables(fits, kind="cubic")
    rows = [
        Polynomial(symbol, *tables.cubic[name])
        for symbol, name in (("R0", "r0_ohm"), ("R1", "r1_ohm"), ("R2", "r2_ohm"))
    ]
    for symbol, c, r in (("C1", "c1_F", "r1_ohm"), ("C2", "c2_F", "r2_ohm")):
        there = [f for f in fits if getattr(f, r) > BRANCH_SHARE * f.r0_ohm]
        if there:
            soc = np.array([f.soc for f in there])
            value = np.array([getattr(f, c) for f in there])
            rows.append(Polynomial(symbol, *cubic_fit(soc, value)))
    return tuple(rows)


# The embedded cell whose numbers stand beside the published ones.
NMC_EMBEDDED = "NMC811 / graphite-SiOx 21700, physics model, 5 Ah"
METHODS = {
    "segments": "segments on the pulse",
    "segments-relaxation": "segments on the relaxation",
    "ours": "varpro, refined",
}
LEAST_RELAXATION_ROWS = 10
NAN = float("nan")


@dataclass(frozen=True)
class RateResult:
    """One characterization rate: its capacity [Ah] and the error of each method on its HPPC log."""

    rate: str
    capacity_Ah: float
    errors: Mapping[str, ErrorMetrics]


def ncr_tables(
    logs: Mapping[str, tuple[CellLog, CellLog]],
    nominal_Ah: float,
    *,
    progress: Progress | None = None,
) -> tuple[RateResult, ...]:
    """Errors by characterization rate and method.

    Parameters
    ----------
    logs : mapping      rate -> (HPPC log, capacity test) at that rate
    nominal_Ah : float

    Raises
    ------
    InputError        as `identify_cell`
    """
    say = progress or (lambda _: None)
    found = []
    for rate, (hppc, capacity) in logs.items():
        tests = TestLogs(hppc=((hppc, None),), capacity=(capacity,))
        say(f"NCR18650B paper, {rate}: segments")
        paper = identify_cell(
            tests, IdentifySettings(nominal_Ah=nominal_Ah, method="segments", refine=False)
        )
        say(f"NCR18650B paper, {rate}: varpro, refined")
        ours = identify_cell(tests, IdentifySettings(nominal_Ah=nominal_Ah))
        errors = {
            "segments": paper.simulations[0].metrics,
            "segments-relaxation": _on_relaxation(paper, hppc),
            "ours": ours.simulations[0].metrics,
        }
        found.append(RateResult(rate, paper.model.capacity_Ah, errors))
    return tuple(found)


def _on_relaxation(paper: Identification, hppc: CellLog) -> ErrorMetrics:
    """Error of the tables that the relaxations give, all else as with the pulses."""
    pulses = paper.temperatures[0].pulse_sets[0]
    soc = pulses.anchor.soc - hppc.counted_charge_Ah() / paper.model.capacity_Ah
    edges = [(p.stop, p.relax_stop, p.current_A, float(soc[p.stop - 1])) for p in pulses.pulses]
    tables = pulse_tables(relaxation_segments(hppc, edges), paper.model.points)
    warm = [float(paper.model.temperature_C[0])]
    model = plain_model([tables], paper.ocv, paper.model.capacity_Ah, warm)
    return simulate(model, hppc, paper.simulations[0].soc0).metrics


def relaxation_segments(
    log: CellLog, edges: Sequence[tuple[int, int, float, float]]
) -> list[PulseFit]:
    """Equations (6) to (9) on what follows each pulse.

    t0 is the pulse's last row, t1 the first row without current, t3 the last before the next
    current, t2 the row nearest to ``fast_part`` of the way from t1 to t3.

    Parameters
    ----------
    log : CellLog
    edges : sequence of (stop, relax_stop, current_A, soc)     first row after the pulse, first row
                        of the next current, current of the pulse [A], SOC at rest
    """
    time, voltage = log.time_s, log.voltage_V
    fits = []
    for row1, stop, current_A, soc in edges:
        row0, row3 = row1 - 1, stop - 1
        if row3 - row1 < LEAST_RELAXATION_ROWS:
            continue
        wanted = time[row1] + SEGMENTS.fast_part * (time[row3] - time[row1])
        row2 = int(np.argmin(np.abs(time[row1 + 1 : row3] - wanted))) + row1 + 1
        current = abs(current_A)
        value = PulseParameters(
            r0_ohm=abs(voltage[row0] - voltage[row1]) / current,
            r1_ohm=abs(voltage[row1] - voltage[row2]) / current,
            tau1_s=(time[row2] - time[row1]) / SEGMENTS.taus,
            r2_ohm=abs(voltage[row1] - voltage[row3]) / current,
            tau2_s=(time[row3] - time[row1]) / SEGMENTS.taus,
            ocv_V=float(voltage[row3]),
        )
        fits.append(
            PulseFit(
                method="segments",
                soc=soc,
                current_A=current_A,
                duration_s=NAN,
                value=value,
                error=PulseParameters(*[NAN] * 6),
                rmse_V=NAN,
                rows=row3 - row0 + 1,
            )
        )
    return fits
