"""Make the curves of cells that nobody here measured again: `python datasets/population.py`.

What a cell may be like is learnt from the stock models and from these: full cells of PyBaMM's
published parameter sets (`pip install pybamm`), and cells balanced here of the negative electrode
of one set and the positive one of another, since makers combine and balance them in more ways than
were published. Each is an OCV at 25 degC over SOC, from its lower to its upper limit; `lineage`
names the stock model whose own cell a curve is of.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

from cellwise.files import write_atomically
from cellwise.typing import FloatArray

HERE = Path(__file__).resolve().parent
SOC = np.linspace(0.0, 1.0, 101)
TEMPERATURE_K = 298.15
LAYERED = ("Chen2020", "Mohtat2020", "Ai2020", "Ramadass2004", "Marquis2019",
           "Ecker2015", "NCA_Kim2011")  # fmt: skip
LFP, LFP_LINEAGE = "Prada2013", "lfp-26650"
GRAPHITES = ("Marquis2019", "Ecker2015", "Mohtat2020", "Chen2020")
# How full the graphite is at the upper limit, how full the LFP at the lower one, lower limit [V].
BALANCES = ((0.75, 0.95, 2.0), (0.85, 0.88, 2.5))
NEGATIVES = ("Chen2020", "ORegan2022", "Mohtat2020", "Ecker2015", "Marquis2019", "Ai2020",
             "Ramadass2004")  # fmt: skip
POSITIVES = ("Chen2020", "ORegan2022", "Ecker2015", "NCA_Kim2011", "Marquis2019", "Ai2020")
# Shares of how full the electrodes are at the ends of their own cells, that they are used to.
SHARES = ((1.0, 1.0), (0.93, 0.97))
FULLEST = 0.93  # of a negative electrode: beyond, lithium plates
LIMITS_V = (2.5, 4.2)
UPPER_V = 3.6
FALLS_V = 1e-3  # from one point to the next: more is no OCV

Potential = Callable[[FloatArray | float], FloatArray]


def main() -> int:
    """Write one file."""
    parser = argparse.ArgumentParser(prog="population", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=HERE / "population" / "ocv.json")
    arguments = parser.parse_args()
    cells = [full_cell(name, "layered") for name in LAYERED]
    cells += [{**full_cell(LFP, "lfp"), "lineage": [LFP_LINEAGE]}]
    cells += [balanced_lfp(graphite, *balance) for graphite in GRAPHITES for balance in BALANCES]
    pairs = [(negative, positive) for negative in NEGATIVES for positive in POSITIVES]
    tried = [balanced_oxide(*pair, *share) for pair in pairs for share in SHARES]
    cells += [cell for cell in tried if cell is not None]
    write_atomically(arguments.output, json.dumps({"cells": cells}, separators=(",", ":")) + "\n")
    print(f"{arguments.output}: {len(cells)} cells")
    return 0


def full_cell(name: str, class_: str) -> dict[str, Any]:
    """A published cell as it is."""
    x0, x1, y1, y0 = ends(name)
    negative, positive = electrode(name, "n"), electrode(name, "p")
    voltage = positive(y0 + SOC * (y1 - y0)) - negative(x0 + SOC * (x1 - x0))
    return entry(f"PyBaMM {name}", class_, voltage)


def balanced_lfp(graphite: str, x1: float, y0: float, lower_V: float) -> dict[str, Any]:
    """An LFP cell of another set's graphite."""
    limits_V = (lower_V, UPPER_V)
    voltage = balanced(electrode(graphite, "n"), electrode(LFP, "p"), x1, y0, limits_V)
    if voltage is None:
        raise RuntimeError(f"{graphite} and {LFP} do not reach {limits_V} V")
    return entry(f"{graphite} graphite, {LFP} LFP, {x1:g}, {y0:g}", "lfp", voltage)


def balanced_oxide(
    negative: str, positive: str, share_negative: float, share_positive: float
) -> dict[str, Any] | None:
    """A cell of two sets' electrodes; None where they do not reach the limits."""
    x1 = share_negative * min(ends(negative)[1], FULLEST)
    y0 = share_positive * ends(positive)[3]
    voltage = balanced(electrode(negative, "n"), electrode(positive, "p"), x1, y0, LIMITS_V)
    if voltage is None or np.any(np.diff(voltage) < -FALLS_V):
        return None
    name = f"{negative} negative, {positive} positive, {share_negative:g}, {share_positive:g}"
    return entry(name, "layered", voltage)


def balanced(
    negative: Potential, positive: Potential, x1: float, y0: float, limits_V: tuple[float, float]
) -> FloatArray | None:
    """OCV of a cell whose electrodes are so full at its ends; the other two ends follow."""
    lower_V, upper_V = limits_V
    try:
        y1 = brentq(lambda y: float(positive(y) - negative(x1)) - upper_V, 1e-4, 0.9)
        x0 = brentq(lambda x: float(positive(y0) - negative(x)) - lower_V, 1e-5, 0.4)
    except ValueError:  # no such voltage in between
        return None
    return np.asarray(positive(y0 + SOC * (y1 - y0)) - negative(x0 + SOC * (x1 - x0)))


@cache
def ends(name: str) -> tuple[float, ...]:
    """Filling of the negative electrode at empty and full, of the positive at full and empty."""
    import pybamm

    found = pybamm.lithium_ion.get_min_max_stoichiometries(pybamm.ParameterValues(name))
    return tuple(float(x) for x in found)


@cache
def electrode(name: str, side: str) -> Potential:
    """OCP of one electrode of a set over its filling [V]."""
    import pybamm

    values = pybamm.ParameterValues(name)
    part = getattr(pybamm.LithiumIonParameters(), side).prim
    near = np.geomspace(1e-5, 0.01, 100)  # of an end, where potentials are steep
    filling = np.concatenate((near, np.linspace(0.011, 0.989, 979), 1.0 - near[::-1]))
    found = [values.evaluate(part.U(pybamm.Scalar(float(x)), TEMPERATURE_K)) for x in filling]
    potential_V = np.ravel(np.array(found, dtype=np.float64))
    known = np.isfinite(potential_V)
    return lambda x: np.interp(x, filling[known], potential_V[known])


def entry(name: str, class_: str, voltage_V: FloatArray) -> dict[str, Any]:
    """A cell of the file."""
    rounded = [round(float(v), 4) for v in voltage_V]
    return {"name": name, "class": class_, "lineage": [], "ocv_V": rounded}


if __name__ == "__main__":
    sys.exit(main())
