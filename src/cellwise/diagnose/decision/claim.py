"""Whether an error is more than the model claims of itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from cellwise.cell.model import CellModel
from cellwise.diagnose.fit.noise import STATED_ERRORS, share_claimed
from cellwise.diagnose.fit.rows import Evidence
from cellwise.diagnose.log_runs import LogRun
from cellwise.identify.refinement.sustained import charged_for_minutes
from cellwise.typing import FloatArray

# An error that the claim would give once in a thousand logs is beyond it.
RARE = 1e-3
# Row-to-row noise of another sensor than the model's data had is no error of the model: up to this.
MOST_NOISE_V = 0.005
NORMAL = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True)
class ClaimCheck:
    """A log's error over what the model claims there, and how much of that chance would give."""

    log: str
    rmse_V: float
    claim_V: float
    times: float
    most: float

    @property
    def beyond(self) -> bool:
        """Whether the error is larger than the claim allows."""
        return self.times > self.most

    def text(self) -> str:
        """For people."""
        return (
            f"the error on {self.log or 'the log'} is {1e3 * self.rmse_V:.1f} mV RMSE, "
            f"{self.times:.1f} times what the model claims of itself there"
        )


def claim_checks(
    model: CellModel, runs: Sequence[LogRun], evidence: Evidence
) -> tuple[ClaimCheck, ...]:
    """Every log as `simulate` shows it before any correction.

    The claim at a row is the model's slow error at its SOC, its share of the polarisation,
    its noise, and what the initial SOC leaves uncertain through the slope of the OCV. The slow part
    stays for ``correlation_s``, so that a log holds few independent errors, and the claim itself
    comes from few (``STATED_ERRORS``): the mean square over the claim's is compared with the F
    distribution of as many degrees of freedom.
    """
    found = []
    for run, rows in zip(runs, evidence.logs, strict=True):
        soc = np.clip(run.before.soc, 0.0, 1.0)
        temperature = float(np.median(rows.temperature_C))
        middle = model.at_temperature(temperature)
        drop = np.interp(soc, model.soc, middle.ocv_V[0]) - run.before.voltage_V
        share = share_claimed(model.error, drop, charged_for_minutes(run.log))
        slope = np.interp(soc, model.soc, np.gradient(middle.ocv_V[0], model.soc))
        claim2 = (
            np.asarray(model.slow_error_V(soc, temperature)) ** 2
            + (share * drop) ** 2
            + max(model.error.white_V, _noise_V(run.before.error_V)) ** 2
            + (rows.start.std * slope) ** 2
        )
        error = run.before.error_V
        known = np.isfinite(error)
        if not known.any():
            continue
        times2 = float(np.mean(error[known] ** 2 / claim2[known]))
        freedom = 1.0 + run.log.duration_s / (2.0 * max(model.error.correlation_s, 1.0))
        most2 = float(f_distribution.isf(RARE, freedom, STATED_ERRORS))
        found.append(
            ClaimCheck(
                run.log.name,
                run.before.metrics.rmse_V,
                float(np.sqrt(np.mean(claim2[known]))),
                float(np.sqrt(times2)),
                float(np.sqrt(most2)),
            )
        )
    return tuple(found)


def _noise_V(error_V: FloatArray) -> float:
    """Row-to-row noise of a log, by the differences of its error."""
    steps = np.abs(np.diff(error_V))
    steps = steps[np.isfinite(steps)]
    if steps.size == 0:
        return 0.0
    return min(NORMAL * float(np.median(steps)) / math.sqrt(2.0), MOST_NOISE_V)
