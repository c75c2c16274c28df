"""Where the data of an update have been, and what of the model is the prior's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.prior.update import Update
from cellwise.identify.refinement.model_error import (
    POINTS,
    SAME_TEMPERATURE_K,
    ResidualLog,
    estimate_model_error,
)
from cellwise.typing import FloatArray

BINS = 50  # of the SOC axis, for where the data have been
# Half of the rows further off is another kind of cell: 5 points of SOC over a range of 1 V.
# Right kinds leave 1 to 32 mV of ten cells from 40 to -20 degC, LFP for nickel 57 to 274.
POOR_V = 0.05
SHORT_OF_ALL = 0.02  # of the SOC range: a gap at an end that is no worth a word


@dataclass(frozen=True)
class Seen:
    """SOC, temperature and current over which the data were compared.

    ``soc`` and ``unseen_soc`` are stretches (lowest, highest); the others one range each;
    ``temperature_C`` is None where nobody measured one, and ``assumed_C`` what was taken.
    """

    soc: tuple[tuple[float, float], ...]
    unseen_soc: tuple[tuple[float, float], ...]
    temperature_C: tuple[float, float] | None
    current_A: tuple[float, float]
    assumed_C: float | None

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "seen": {
                "soc": [list(s) for s in self.soc],
                "temperature_C": self.temperature_C and list(self.temperature_C),
                "assumed_temperature_C": self.assumed_C,
                "current_A": list(self.current_A),
            },
            "from_prior": {"soc": [list(s) for s in self.unseen_soc]},
        }

    def notices(self, name: str, prior: CellModel) -> list[str]:
        """What of the model is the prior's, for people."""
        found = []
        if self.unseen_soc:
            listed = " and ".join(f"{low:.2f} to {high:.2f}" for low, high in self.unseen_soc)
            found.append(
                f"the data show nothing at SOC {listed}: there the model is the prior {name}, "
                "with its spread as error"
            )
        if self.assumed_C is not None:
            some = "of some logs " if self.temperature_C else ""
            found.append(
                f"no temperature {some}was measured: {self.assumed_C:.0f} degC is assumed "
                "(LOG@10 states another)"
            )
        if self.temperature_C is None:
            return found
        low, high = self.temperature_C
        cold, warm = float(prior.temperature_C[0]), float(prior.temperature_C[-1])
        beyond = [f"down to {cold:.0f} degC"] if cold < low - SAME_TEMPERATURE_K else []
        beyond += [f"up to {warm:.0f} degC"] if warm > high + SAME_TEMPERATURE_K else []
        if beyond:
            found.append(
                f"the data are at {low:.0f} to {high:.0f} degC: {' and '.join(beyond)} the model "
                f"follows the prior {name}"
            )
        return found


def seen_by(found: Update) -> Seen:
    """Where the compared rows of the logs lie, by the SOC that was found."""
    soc = np.concatenate([one.soc for one in found.logs])
    current = np.concatenate([one.log.known_current_A()[one.rows] for one in found.logs])
    measured, assumed = (
        [one.temperature_C for one in found.logs if (one.log.temperature_C is None) == missing]
        for missing in (False, True)
    )
    counts, edges = np.histogram(np.clip(soc, 0.0, 1.0), BINS, (0.0, 1.0))
    low, high = np.percentile(np.concatenate(measured), [1.0, 99.0]) if measured else (0.0, 0.0)
    return Seen(
        soc=_stretches(counts > 0, edges),
        unseen_soc=tuple(s for s in _stretches(counts == 0, edges) if s[1] - s[0] > SHORT_OF_ALL),
        temperature_C=(round(float(low), 1), round(float(high), 1)) if measured else None,
        current_A=(float(f"{current.min():.4g}"), float(f"{current.max():.4g}")),
        assumed_C=float(np.median(np.concatenate(assumed))) if assumed else None,
    )


def error_of(found: Update, corrections: Corrections) -> tuple[ModelError, FloatArray]:
    """The updated model's error, and the standard deviation of its OCV over the model's grid [V].

    What the residuals show where the data have been, and what is uncertain of the OCV and the
    resistances given these data: far from them, as much as of the prior.
    """
    shown = estimate_model_error(
        [
            ResidualLog(
                one.log.time_s[one.rows],
                one.soc,
                one.drop_V,
                one.residual_V,
                float(np.median(one.temperature_C)),
            )
            for one in found.logs
        ]
    )
    ocv_std, r0_std = (
        np.sqrt(np.einsum("ij,jk,ik->i", shape, found.covariance, shape))
        for shape in (corrections.ocv_map, corrections.ln_r_maps[0])
    )
    grid = np.linspace(0.0, 1.0, POINTS)
    level_V = np.interp(grid, found.model.soc, ocv_std)
    return shown.with_slow(level_V, float(np.median(r0_std))), ocv_std


def poor_fit(found: Update, name: str) -> tuple[Notice, ...]:
    """What is said first where the prior cannot be brought to a log, of the log furthest off."""
    typical = [float(np.median(np.abs(one.residual_V))) for one in found.logs]
    worst = int(np.argmax(typical))
    if typical[worst] <= POOR_V:
        return ()
    text = (
        f"even updated, the prior {name} DOES NOT FIT: typically {1e3 * typical[worst]:.0f} mV off "
        f"'{found.logs[worst].log.name}': another kind of cell, number of cells in series "
        "(`series=N`) or unit?"
    )
    return (Notice(RANGE_V, text),)


def _stretches(
    inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], edges: FloatArray
) -> tuple[tuple[float, float], ...]:
    """Runs of bins, as lowest and highest edge."""
    padded = np.concatenate(([False], inside, [False])).astype(int)
    starts, stops = np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1)
    return tuple(
        (round(float(edges[a]), 3), round(float(edges[b]), 3))
        for a, b in zip(starts, stops, strict=True)
    )
