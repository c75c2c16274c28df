"""The names that the pages use are there, whatever was imported before them."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys, types
from importlib import import_module
for name in sys.argv[2:]:
    import_module(name)
import cellwise
names = list(reversed(cellwise.__all__)) if sys.argv[1] == "reversed" else cellwise.__all__
found = {name: getattr(cellwise, name) for name in names}
modules = {n for n, value in found.items() if isinstance(value, types.ModuleType)}
wrong = [n for n in modules if not callable(found[n])]
wrong += [n for n, value in found.items() if getattr(cellwise, n) is not value]
print(" ".join(wrong))
"""


DEEPER = ("cellwise.identify.capacity.capacity_test", "cellwise.estimate.replay")


@pytest.mark.parametrize(
    ("order", "before"),
    [
        ("forward", ()),
        ("reversed", DEEPER),
        pytest.param("reversed", (), marks=pytest.mark.slow),
        pytest.param("forward", DEEPER, marks=pytest.mark.slow),
    ],
)
def test_a_public_name_is_never_a_module(order, before):
    """A name that a folder has too would be hidden once somebody imports the folder."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, order, *before], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []
