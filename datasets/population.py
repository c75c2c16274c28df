"""Make the curves of cells that nobody here measured again: `python datasets/population.py`.

What a cell may be like is learnt from the stock models and from these: full cells of PyBaMM's
published parameter sets (`pip install pybamm`), and LFP cells balanced here of one published LFP
electrode and the graphites of other sets, since every published LFP cell is one cell's. Each is an
OCV at 25 degC over SOC, from the set's lower to its upper limit; `lineage` names the stock model
whose own cell a curve is of.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
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
UPPER_V = 3.6


def main() -> int:
    """Write one file."""
    parser = argparse.ArgumentParser(prog="population", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=HERE / "population" / "ocv.json")
    arguments = parser.parse_args()
    cells = [full_cell(name, "layered") for name in LAYERED]
    cells += [{**full_cell(LFP, "lfp"), "lineage": [LFP_LINEAGE]}]
    cells += [balanced(graphite, *balance) for graphite in GRAPHITES for balance in BALANCES]
    write_atomically(arguments.output, json.dumps({"cells": cells}, separators=(",", ":")) + "\n")
    print(f"{arguments.output}: {len(cells)} cells")
    return 0


def full_cell(name: str, class_: str) -> dict[str, Any]:
    """A published cell as it is."""
    import pybamm

    values = pybamm.ParameterValues(name)
    x0, x1, y1, y0 = pybamm.lithium_ion.get_min_max_stoichiometries(values)
    negative, positive = electrode(name, "n"), electrode(name, "p")
    voltage = positive(y0 + SOC * (y1 - y0)) - negative(x0 + SOC * (x1 - x0))
    return entry(f"PyBaMM {name}", class_, voltage)


def balanced(graphite: str, x1: float, y0: float, lower_V: float) -> dict[str, Any]:
    """An LFP cell of another set's graphite: the other two ends follow from the limits."""
    negative, positive = electrode(graphite, "n"), electrode(LFP, "p")

    def at(function: Callable[[FloatArray], FloatArray], filling: float) -> float:
        return float(function(np.array([filling]))[0])

    y1 = brentq(lambda y: at(positive, y) - at(negative, x1) - UPPER_V, 1e-4, 0.5)
    x0 = brentq(lambda x: at(positive, y0) - at(negative, x) - lower_V, 1e-5, 0.3)
    voltage = positive(y0 + SOC * (y1 - y0)) - negative(x0 + SOC * (x1 - x0))
    return entry(f"{graphite} graphite, {LFP} LFP, {x1:g}, {y0:g}", "lfp", voltage)


def electrode(name: str, side: str) -> Callable[[FloatArray], FloatArray]:
    """OCP of one electrode of a set over its filling [V]."""
    import pybamm

    values = pybamm.ParameterValues(name)
    part = getattr(pybamm.LithiumIonParameters(), side).prim

    def ocp(filling: FloatArray) -> FloatArray:
        found = [values.evaluate(part.U(pybamm.Scalar(float(x)), TEMPERATURE_K)) for x in filling]
        return np.ravel(np.array(found, dtype=np.float64))

    return ocp


def entry(name: str, class_: str, voltage_V: FloatArray) -> dict[str, Any]:
    """A cell of the file."""
    rounded = [round(float(v), 4) for v in voltage_V]
    return {"name": name, "class": class_, "lineage": [], "ocv_V": rounded}


if __name__ == "__main__":
    sys.exit(main())
