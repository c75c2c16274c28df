"""One process that reads a file and identifies the cell; prints its times as JSON.

Started by ``file_to_tables`` with an empty compilation cache, then with a filled one.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

BEGAN = time.perf_counter()


def main(file: str, capacity: float, *, repeat: int = 2) -> None:
    """Times of the import, of reading, of the fitted tables and of all, ``repeat`` times."""
    from cellwise.identify import CellTests, IdentifySettings, identify_cell
    from cellwise.logs import read_log

    imported = time.perf_counter() - BEGAN
    runs = []
    for _ in range(repeat):
        began = time.perf_counter()
        log = read_log(Path(file))
        read = time.perf_counter()
        stages: dict[str, float] = {}

        def mark(stage: str, into: dict[str, float] = stages) -> None:
            into[stage.split(" at ")[0]] = time.perf_counter()

        settings = IdentifySettings(nominal_Ah=capacity, capacity_choice="nominal")
        found = identify_cell(CellTests(hppc=log), settings, mark)
        runs.append(
            {
                "read_s": read - began,
                "tables_s": stages["error"] - began,
                "model_s": time.perf_counter() - began,
                "rows": len(log),
                "pulses": found.pulse_counts,
                "rmse_V": found.fit.rmse_V,
            }
        )
    print(json.dumps({"import_s": imported, "runs": runs}))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
