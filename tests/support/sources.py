"""The package's own sources, parsed once: many tests look at all of them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a module; who looks at it leaves it as it is."""
    return ast.parse(path.read_text(encoding="utf-8"))
