"""The example cells of the cell tests serve here as well."""

from __future__ import annotations

import sys
from pathlib import Path

CELLS = str(Path(__file__).parents[1] / "cell")
if CELLS not in sys.path:
    sys.path.insert(0, CELLS)
