"""The NCR18650B paper's tables: one characterization rate at a time, judged on its own current.

Equations (6) to (9) can be read on the pulse or on the relaxation after it. On the pulse the OCV
moves by 10 % of SOC and counts as resistance; on the relaxation it stands still. On the embedded
cell the first way misses by some 90 mV and the second by 10 to 20 mV, the size of the errors that
the paper prints. Which one the paper took is therefore inferred, not known: both are shown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.metrics import ErrorMetrics
from cellwise.cell.simulate import simulate
from cellwise.identify.assemble import plain_model
from cellwise.identify.identification import Identification, IdentifySettings, TestLogs
from cellwise.identify.papers.segments import TAUS_PER_SEGMENT, SegmentOptions
from cellwise.identify.pipeline import Progress, identify_cell
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseParameters
from cellwise.identify.tables import pulse_tables
from cellwise.logs.cell_log import CellLog

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
    log: CellLog,
    edges: Sequence[tuple[int, int, float, float]],
    options: SegmentOptions | None = None,
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
    options = options or SegmentOptions()
    time, voltage = log.time_s, log.voltage_V
    fits = []
    for row1, stop, current_A, soc in edges:
        row0, row3 = row1 - 1, stop - 1
        if row3 - row1 < LEAST_RELAXATION_ROWS:
            continue
        wanted = time[row1] + options.fast_part * (time[row3] - time[row1])
        row2 = int(np.argmin(np.abs(time[row1 + 1 : row3] - wanted))) + row1 + 1
        current = abs(current_A)
        value = PulseParameters(
            r0_ohm=abs(voltage[row0] - voltage[row1]) / current,
            r1_ohm=abs(voltage[row1] - voltage[row2]) / current,
            tau1_s=(time[row2] - time[row1]) / TAUS_PER_SEGMENT,
            r2_ohm=abs(voltage[row1] - voltage[row3]) / current,
            tau2_s=(time[row3] - time[row1]) / TAUS_PER_SEGMENT,
            ocv_V=float(voltage[row3]),
            ocv_slope_V=0.0,
        )
        fits.append(
            PulseFit(
                method="segments",
                soc=soc,
                current_A=current_A,
                duration_s=NAN,
                window_s=float(time[row3] - time[row0]),
                value=value,
                error=PulseParameters(*[NAN] * 7),
                rmse_V=NAN,
                noise_V=NAN,
                rows=row3 - row0 + 1,
            )
        )
    return fits
