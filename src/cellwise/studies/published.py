"""What the two papers print, on their own cells: a reference for the method, not a target.

The numbers stand in `published.toml`.
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

_PAPERS = tomllib.loads((files(__package__) / "published.toml").read_text(encoding="utf-8"))
LFP: dict[str, Any] = _PAPERS["lfp"]
NCR18650B: dict[str, Any] = _PAPERS["ncr18650b"]
