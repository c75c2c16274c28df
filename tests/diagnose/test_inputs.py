"""What `diagnose` refuses from Python: one error that says what was found and what was expected."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.diagnose import diagnose
from cellwise.diagnose.checks import causes_of
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CELL = curved_cell()
LOG = CellLog(np.arange(400.0), np.sin(np.arange(400.0) / 9.0), np.full(400, 3.7))


@pytest.mark.parametrize(
    ("arguments", "options", "word"),
    [
        ((CELL, "x"), {}, "log = 'x'"),
        ((CELL, 5), {}, "log = 5"),
        ((CELL, None), {}, "log = None"),
        ((CELL, [LOG, "x"]), {}, "log = 'x'"),
        (("x", LOG), {}, "model = 'x'"),
        ((CELL, LOG, "x"), {}, "log = 'x'"),
        ((CELL, LOG), {"baseline": 3}, "log = 3"),
        ((CELL, LOG), {"soc0": "full"}, "soc0 = 'full'"),
        ((CELL, LOG), {"soc0": "auto"}, "soc0 = 'auto'"),
        ((CELL, LOG), {"soc0": ["0.9"]}, "soc0 = '0.9'"),
        ((CELL, LOG), {"soc0": [0.9, 0.9]}, "soc0 for 2 logs"),
        ((CELL, LOG), {"causes": "gremlins"}, "cause 'gremlins'"),
        ((CELL, LOG), {"causes": ["current_offset", "moon"]}, "cause 'moon'"),
        ((CELL, LOG), {"causes": 5}, "cause 5"),
        ((CELL, LOG), {"reference_capacity_Ah": "x"}, "reference_capacity_Ah = 'x'"),
    ],
)
def test_bad_input_to_diagnose_gets_one_error(arguments, options, word):
    with pytest.raises(InputError) as said:
        diagnose(*arguments, **options)
    assert word in said.value.found
    assert said.value.action


def test_one_cause_by_its_name():
    assert [c.name for c in causes_of("capacity")] == ["capacity"]


def test_too_little_and_another_cell_are_undetermined_and_say_why():
    time = np.arange(600.0)
    quiet = CellLog(time, np.zeros(600), np.full(600, 3.7))
    assert diagnose(CELL, quiet).verdict == "undetermined"
    assert "too quiet" in diagnose(CELL, quiet).reasons[0]
    short = CellLog(time[:40], np.ones(40), np.full(40, 3.7))
    assert "too short" in diagnose(CELL, short).reasons[0]
    other = CellLog(time, np.ones(600) * CELL.capacity_Ah, np.full(600, 1.2))
    found = diagnose(CELL, other, soc0=0.5)
    assert found.verdict == "undetermined"
    assert "another cell" in found.reasons[0]
    assert not found.causes
