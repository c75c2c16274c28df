"""A physics laboratory: cells that PyBaMM makes, cellwise's own identification, one thing changed.

``python -m benchmarks.physics_laboratory make FOLDER`` needs PyBaMM (``pip install
'cellwise[benchmark]'``) and writes cases; ``judge FOLDER`` diagnoses them and needs no PyBaMM.
"""

from __future__ import annotations

import sys

from benchmarks.measured_data import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "tests" / "support" / "loads"))
