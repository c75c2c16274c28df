"""The tables of the two papers that cellwise starts from, on the embedded data, published beside.

The LFP040AHA paper identifies by single pulses and judges on a load profile. The NCR18650B paper
takes one characterization rate at a time and judges on its own current. Its equations (6) to (9)
can be read on the pulse or on the relaxation after it. On the pulse the OCV moves by 10 % of SOC
and counts as resistance; on the relaxation it stands still. On the embedded cell the first way
misses by some 90 mV and the second by 10 to 20 mV, the size of the errors that the paper prints.
Which one the paper took is therefore inferred, not known: both are shown.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.metrics import ErrorMetrics, metrics_to_dict
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.identify.assemble import plain_model
from cellwise.identify.capacity.capacity_choice import capacity_table, usable_tests
from cellwise.identify.hppc.pulse_quality import Pulse, PulseQuality
from cellwise.identify.identification import CellTests, Identification, IdentifySettings
from cellwise.identify.papers.log_linear_exp import fit_log_linear_exp
from cellwise.identify.papers.segments import SEGMENTS
from cellwise.identify.pipeline import Progress, identify_cell
from cellwise.identify.pulse_fit.circuit import PulseFit, PulseParameters
from cellwise.identify.pulse_fit.fit_pulse import Method
from cellwise.identify.tables import cubic_fit, pulse_tables
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.published import LFP, NCR18650B

# The embedded cells whose numbers stand beside the published ones.
LFP_EMBEDDED = "LFP / graphite 26650, physics model, 2.3 Ah"
NMC_EMBEDDED = "NMC811 / graphite-SiOx 21700, physics model, 5 Ah"
LFP_NOMINAL_AH, NMC_NOMINAL_AH = 2.3, 5.0
LFP_CAPACITY_TESTS = ("cap_0p5c", "cap_1c", "cap_2c", "cap_3c")
NMC_RATES = {"C/20": "c20", "C/5": "c5", "C/3": "c3"}
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
LEAST_RELAXATION_ROWS = 10
NAN = float("nan")


def paper_tables(
    datasets: Path, progress: Progress | None = None, *, method: Method = "pso"
) -> dict[str, Any]:
    """Both papers' tables as JSON values, with the published numbers beside ours.

    Parameters
    ----------
    datasets : Path           folder with ``lfp`` and ``nmc``
    progress : callable       called with what is being done
    method : str              for the pulses of the LFP paper: ``pso`` as printed there, or
                              ``varpro``, which is quicker

    Raises
    ------
    InputError        a log is missing
    """
    began = time.perf_counter()
    say = progress or (lambda _: None)
    tests = CellTests(
        hppc=((_log(datasets, "lfp/hppc"), None),),
        capacity=tuple(_log(datasets, f"lfp/{name}") for name in LFP_CAPACITY_TESTS),
    )
    lfp = lfp_tables(tests, _log(datasets, "lfp/cdc"), method, say)
    rates = [
        rate_row(rate, _log(datasets, f"nmc/hppc_{tag}"), _log(datasets, f"nmc/cap_{tag}"), say)
        for rate, tag in NMC_RATES.items()
    ]
    ncr = {"cell": NMC_EMBEDDED, "published_cell": NCR18650B["cell"], "rates": rates}
    return {"lfp": lfp, "ncr18650b": ncr, "seconds": round(time.perf_counter() - began, 1)}


def _log(datasets: Path, name: str) -> CellLog:
    file = datasets / f"{name}.parquet"
    if not file.exists():
        raise InputError(
            f"no file '{name}.parquet' in the folder of embedded data",
            "the embedded logs of lfp and nmc",
            "Run `cellwise data generate`, or give the folder that holds them.",
        )
    return read_log(file)


def lfp_tables(tests: CellTests, cycle: CellLog, method: Method, say: Progress) -> dict[str, Any]:
    """The LFP paper's: the cell identified for every capacity choice, its way and ours.

    The paper's way: single pulses, equation 8 through the rests, cubic polynomials over SOC, no
    refinement. Judged on ``cycle``, its charge-depleting cycle.
    """
    errors, found = [], []
    for choice, name in CHOICES.items():
        plain = IdentifySettings(nominal_Ah=LFP_NOMINAL_AH, capacity_choice=choice)
        say(f"LFP paper, capacity {name}: {method}, cubic polynomials")
        as_printed = replace(plain, method=method, tables="cubic", refine=False)
        paper = identify_cell(tests, as_printed)
        ocv = fit_log_linear_exp(paper.ocv.points_soc, paper.ocv.points_V)
        found.append((paper, ocv))
        model = paper.model
        model = replace(model, ocv_V=np.tile(ocv.evaluate(model.soc), (len(model.ocv_V), 1)))
        say(f"LFP paper, capacity {name}: varpro, refined")
        errors.append(
            {
                "choice": choice,
                "capacity_Ah": model.capacity_Ah,
                "paper_method": cycle_error(model, cycle),
                "ours": cycle_error(identify_cell(tests, plain).model, cycle),
                "published": LFP["errors"].get(choice),
            }
        )
    first, ocv = found[0]
    points_V, spline = first.ocv.points_V, first.ocv.function.evaluate(first.ocv.points_soc)
    pulses, (hppc, _) = first.temperatures[0].pulse_sets[0], tests.hppc[0]
    soc = pulses.anchor.soc - hppc.counted_charge_Ah() / first.model.capacity_Ah
    each = split_tests(hppc, pulses.pulses, soc)
    charges = dict(enumerate(LFP["test_charges_Ah"], start=1))
    return {
        "cell": LFP_EMBEDDED,
        "published_cell": LFP["cell"],
        "pulse_method": method,
        "capacity": [
            {
                **{k: getattr(row, k) for k in ("rate", "total_Ah", "cc_Ah", "cv_Ah")},
                "published": LFP["capacities"].get(row.rate),
            }
            for row in capacity_table(usable_tests(first.capacity_tests))
        ],
        "pulses": [{**one, "published_charge_Ah": charges.get(one["number"])} for one in each],
        "hppc_total_Ah": sum(one["charge_Ah"] for one in each),
        "ocv": [
            {**asdict(ocv), "spline_rmse_V": float(np.sqrt(np.mean((points_V - spline) ** 2)))}
        ],
        "polynomials": [
            {
                "parameter": name,
                **dict(zip("abcd", own, strict=True)),
                "published": dict(zip("abcd", LFP["polynomials"][name], strict=True)),
            }
            for name, own in polynomials(pulses.fits).items()
        ],
        "errors": errors,
    }


def cycle_error(
    model: CellModel, log: CellLog, window_s: tuple[float, float] = WINDOW_S
) -> dict[str, float]:
    """Error of a model from a full cell over a load profile; shares are of the measured voltage."""
    simulated = simulate(model, log, 1.0)
    error = simulated.residual_V
    known = np.isfinite(error)
    share = np.abs(error[known]) / log.voltage_V[known]
    since = log.time_s[known] - log.time_s[0]
    inside = share[(since >= window_s[0]) & (since <= window_s[1])]
    return {
        "rms_V": simulated.rmse_V,
        "mean_abs": float(np.mean(share)),
        "mean_abs_window": float(np.mean(inside)) if inside.size else NAN,
        "peak": float(np.max(share)),
        "peak_window": float(np.max(inside)) if inside.size else NAN,
    }


def split_tests(
    log: CellLog, pulses: Sequence[Pulse], soc: Sequence[float] | np.ndarray
) -> list[dict[str, Any]]:
    """The log's HPPC tests: each holds some short pulses and ends with a move to another SOC."""
    counted = log.counted_charge_Ah()
    ends = [p.stop - 1 for p in pulses if p.role == "move"]
    short = [p for p in pulses if p.role == "pulse"]
    if not ends or (short and short[-1].start > ends[-1]):
        ends.append(len(log) - 1)
    found = []
    for number, (begin, end) in enumerate(pairwise([0, *ends]), start=1):
        here = [p.quality for p in short if begin <= p.start <= end]
        charge = float(counted[end] - counted[begin])
        count = {q: here.count(q) for q in QUALITIES}
        one = {"number": number, "soc_start": float(soc[begin]), "charge_Ah": charge}
        found.append(one | count)
    return found


def polynomials(fits: Sequence[PulseFit]) -> dict[str, tuple[float, ...]]:
    """A + b s + c s^2 + d s^3 of R0, R1, R2 [ohm], C1, C2 [F] through the pulses (equation 9)."""
    tables = pulse_tables(fits, kind="cubic")
    resistances = {"R0": "r0_ohm", "R1": "r1_ohm", "R2": "r2_ohm"}
    found = {symbol: tuple(tables.cubic[name]) for symbol, name in resistances.items()}
    for symbol, c, r in (("C1", "c1_F", "r1_ohm"), ("C2", "c2_F", "r2_ohm")):
        there = [f for f in fits if getattr(f, r) > BRANCH_SHARE * f.r0_ohm]
        if there:
            value = np.array([getattr(f, c) for f in there])
            found[symbol] = tuple(cubic_fit(np.array([f.soc for f in there]), value))
    return found


def rate_row(rate: str, hppc: CellLog, capacity: CellLog, say: Progress) -> dict[str, Any]:
    """One characterization rate of the NCR18650B paper: errors of each method on its HPPC log."""
    tests = CellTests(hppc=((hppc, None),), capacity=(capacity,))
    plain = IdentifySettings(nominal_Ah=NMC_NOMINAL_AH)
    say(f"NCR18650B paper, {rate}: segments")
    paper = identify_cell(tests, replace(plain, method="segments", refine=False))
    say(f"NCR18650B paper, {rate}: varpro, refined")
    methods = {
        "segments": paper.simulations[0].metrics,
        "segments-relaxation": _on_relaxation(paper, hppc),
        "ours": identify_cell(tests, plain).simulations[0].metrics,
    }
    return {
        "rate": rate,
        "capacity_Ah": paper.model.capacity_Ah,
        "methods": {name: metrics_to_dict(m) for name, m in methods.items()},
        "published": NCR18650B["residuals"].get(rate),
    }


def _on_relaxation(paper: Identification, hppc: CellLog) -> ErrorMetrics:
    """Error of the tables that the relaxations give, all else as with the pulses."""
    pulses = paper.temperatures[0].pulse_sets[0]
    soc = pulses.anchor.soc - hppc.counted_charge_Ah() / paper.model.capacity_Ah
    edges = [(p.stop, p.relax_stop, p.current_A, float(soc[p.stop - 1])) for p in pulses.pulses]
    tables = pulse_tables(relaxation_segments(hppc, edges))
    temperature_C = [float(paper.model.temperature_C[0])]
    model = plain_model([tables], paper.ocv, paper.model.capacity_Ah, temperature_C)
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
