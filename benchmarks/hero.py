"""The picture at the head of the README: a drive of a measured cell that no fit has seen.

python -m benchmarks.hero [OUT.png]        docs/pictures/hero.png unless named
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.accuracy.judging import POINTS_OFF
from benchmarks.accuracy.panasonic import (
    CELL,
    FROM_FULL,
    NOMINAL_AH,
    REFERENCE_AH,
    panasonic_tests,
)
from benchmarks.measured_data import HOW, REPOSITORY, data_folder, measured_log
from cellwise import IdentifySettings, identify_cell, replay, simulate
from cellwise.errors import InputError
from cellwise.report import hero_figure


def main(path: Path) -> Path:
    """Identify, simulate US06, replay it from 30 points off, draw.

    Raises
    ------
    InputError        no measured data
    """
    data = data_folder()
    if data is None:
        raise InputError("no folder of measured cells", "the Panasonic NCR18650PF's", HOW)
    settings = IdentifySettings(nominal_Ah=NOMINAL_AH, name="Panasonic NCR18650PF")
    found = identify_cell(panasonic_tests(data), settings)
    drive = measured_log(data, f"{CELL}/drive_p25_us06")
    estimated = replay(
        found.model,
        drive,
        "ekf",
        soc0=FROM_FULL - POINTS_OFF,
        reference_soc0=FROM_FULL,
        reference_capacity_Ah=REFERENCE_AH,
    )
    return hero_figure(found, simulate(found.model, drive, soc0=FROM_FULL), estimated, path)


if __name__ == "__main__":
    named = Path(sys.argv[1]) if sys.argv[1:] else REPOSITORY / "docs" / "pictures" / "hero.png"
    print(main(named))
