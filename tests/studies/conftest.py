"""Studies of the embedded cells, identified without refinement so that a choice takes a second."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise.studies.capacity_study import StudyCell, study_cell


@pytest.fixture(scope="module")
def quick():
    """Study a cell on some choices, quickly."""

    def run(cell: StudyCell, *choices: str, estimators=("coulomb", "ekf")):
        return study_cell(
            replace(cell, settings=replace(cell.settings, refine=False)), choices, estimators
        )

    return run


@pytest.fixture(scope="session")
def by_choice():
    """Results of a study by choice."""
    return lambda study: {c.choice: c for c in study.choices}


@pytest.fixture(scope="session")
def counting_error():
    """SOC error that counting makes with a capacity that is not the reference, at the lowest SOC.

    soc0 - Ah / Q against soc0 - Ah / Q_ref, until the scale is at its end.
    """

    def at_end(cell: StudyCell, capacity_Ah: float) -> float:
        errors = []
        for judged in cell.judged:
            drawn = judged.log.charge_Ah - judged.log.charge_Ah[0]
            most = float(drawn.max())
            own = max(judged.soc0 - most / capacity_Ah, 0.0)
            errors.append(own - (judged.soc0 - most / cell.reference_Ah))
        return sum(errors) / len(errors)

    return at_end
