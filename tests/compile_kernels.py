"""Compile what most tests need on one core, while types are checked on the other.

As `cellwise.first_use`, with the estimators that few commands need.
"""

from __future__ import annotations

from cellwise.cell.stock import named_model
from cellwise.data import load_dataset
from cellwise.estimate.replay import replay
from cellwise.first_use import CAPACITY_AH, LOG, MODEL, ROWS
from cellwise.first_use import main as compile_usual_kernels
from cellwise.identify import CellTests, IdentifySettings, identify_cell

OTHERS = ("fixed-step", "ukf", "coulomb")


def main() -> None:
    """Each kernel is called once."""
    compile_usual_kernels()
    log = load_dataset(LOG)
    model = named_model(MODEL, CAPACITY_AH)
    for estimator in OTHERS:
        replay(model, log.part(0, ROWS), estimator, soc0=0.9)
    identify_cell(CellTests(drive=((log, None),)), IdentifySettings(CAPACITY_AH, prior=model))


if __name__ == "__main__":
    main()
