"""Calibration on logs known to be good, as far as it carries over from one half to the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.model import CellModel
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, complete
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.priors import calibrated
from cellwise.diagnose.fit.rows import HELD, Evidence, gather
from cellwise.logs.cell_log import CellLog

# Shares of what was calibrated that are tried on rows it was not calibrated on.
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)

StartedLog = tuple[CellLog, InitialSoc]


def calibrate(
    fits: CauseFits,
    model: CellModel,
    good: Sequence[StartedLog],
    fits_of: Callable[[Evidence], CauseFits],
) -> float:
    """Move the tolerances of ``fits`` to what the good logs show; returns the share that held.

    One half of the good logs (of a single log, parts of it) is calibrated on, the other says which
    share of that predicts it best: none, where nothing carries over. Then all are calibrated on,
    and that share is taken. The noise that they leave is the least that is assumed.
    """
    half = len(good) // 2
    split = gather(model, good[: half or 1], good[half:] if half else ())
    share = _share_that_holds(fits_of(split))
    known = fits_of(gather(model, good, whole=True))
    found, _ = _fitted(known)
    fits.prior = calibrated(fits.prior, found, share)
    fits.known = fits.known.with_more(*known.squares(found))
    fits.same_age = True
    return share


def _fitted(known: CauseFits) -> tuple[Fit, Noise]:
    return known.base(known.prior)


def _share_that_holds(known: CauseFits) -> float:
    """The share with the smallest squared error on the other half."""
    evidence = known.evidence
    found, noise = _fitted(known)
    prior = known.prior
    held = (evidence.role == HELD) & evidence.known
    if not held.any():
        return 0.0
    size = known.objective(noise).size_V

    def left(share: float) -> float:
        z = {n: v if ":" in n else share * v for n, v in found.z.items()}
        # What the calibration found of a start belongs to the share that it was found with.
        moved = complete(known.objective(noise), replace(found, z=z), prior)
        voltage, _ = evidence.simulate(found.coordinates, moved.z)
        error = (evidence.voltage_V - voltage)[held] / size[held]
        return float(np.mean(error * error))

    return min(SHARES, key=left)
