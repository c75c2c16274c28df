"""The local score of a submission: theorems of a counter, whose errors are known by hand."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from cellwise.benchmark.submission_score import WEIGHTS, score_submission
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.export.package import Export
from cellwise.export.submission import write
from cellwise.logs.cell_log import CellLog, resample
from cellwise.logs.reading import read_log

CAPACITY = 2.0
COUNTER = """
def Model(X, z=None):
    soc = 1.0 if z is None else z + X[0] / 3600.0 / 2.0
    return soc, soc
"""
COUNTER_M = """
function [soc, z] = Model(X, z)
if nargin < 2 || isempty(z)
    soc = 1.0;
else
    soc = z + X(1) / 3600 / 2.0;
end
z = soc;
end
"""


def drive(hours=0.95, current_A=2.0, warm=25.0, begins=0.0):
    """A constant discharge behind a row at rest."""
    n = int(3600 * hours)
    current = np.full(n + 1, current_A)
    current[0] = begins
    time = np.arange(n + 1.0)
    return CellLog(time, current, 3.7 - 1e-5 * time, np.full(n + 1, warm), name=f"d{warm:g}")


@pytest.fixture
def counter(tmp_path):
    (tmp_path / "Model.py").write_text(COUNTER)
    return tmp_path / "Model.py"


def test_a_counter_has_the_errors_that_a_counter_has(counter):
    """None from full; as far off as a late start is; an offset for as long as it counts."""
    found = score_submission(counter, [(drive(), 1.0)], CAPACITY)
    assert found.cases["drives"] == pytest.approx(0.0, abs=1e-6)
    # A padded row has the current 0, then the counter follows: off by what is missing to full.
    assert found.cases["late starts"] == pytest.approx((3 * 10 + 2 * 40 + 70) / 6, abs=0.1)
    counted = 0.3 * (3599 + np.arange(3421)) / 3600 / CAPACITY * 100
    assert found.cases["current offset"] == pytest.approx(np.sqrt(np.mean(counted**2)), rel=1e-3)
    assert "charging" not in found.cases
    present = {n: w for n, w in WEIGHTS.items() if n in found.cases}
    mean = sum(w * found.cases[n] for n, w in present.items()) / sum(present.values())
    assert found.weighted == pytest.approx(mean)
    assert found.to_dict()["missing_cases"] == ["charging"]


def test_an_hour_of_the_first_row_is_before_every_run(tmp_path):
    """It is handed over and not scored: one whose SOC is the number of calls."""
    (tmp_path / "Model.py").write_text(
        "def Model(X, z=None):\n    z = 0 if z is None else z + 1\n    return z, z\n"
    )
    found = score_submission(tmp_path / "Model.py", [(drive(0.1, begins=2.0), 1.0)], CAPACITY)
    calls = 3600 + np.arange(361)
    truth = 1.0 - np.arange(361) * 2.0 / 3600 / CAPACITY
    assert found.runs[0].rmse == pytest.approx(100 * np.sqrt(np.mean((calls - truth) ** 2)))


def test_temperatures_weigh_the_same_however_many_drives_each_has(counter):
    """Five drives at 25 degC and one at 0: the mean over drives is not that over temperatures."""
    logs = [(drive(0.2, warm=25.0), 1.0)] * 5 + [(drive(0.2, warm=1.0), 0.7)]
    found = score_submission(counter, logs, CAPACITY)
    assert found.cases["drives"] == pytest.approx(30.0 / 6.0, abs=0.01)
    assert found.cases["temperatures"] == pytest.approx(30.0 / 2.0, abs=0.01)


def test_a_charge_is_a_case_of_its_own(counter):
    found = score_submission(counter, [(drive(0.5, current_A=-1.0), 0.2)], CAPACITY)
    assert set(found.cases) == {"charging"}
    assert found.weighted == pytest.approx(80.0, abs=0.1)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no GNU Octave")
def test_the_same_in_matlab(tmp_path, counter):
    (tmp_path / "Model.m").write_text(COUNTER_M)
    logs = [(drive(0.2), 1.0)]
    by_python = score_submission(counter, logs, CAPACITY)
    by_octave = score_submission(tmp_path / "Model.m", logs, CAPACITY)
    assert by_octave.weighted == pytest.approx(by_python.weighted, abs=1e-9)
    (tmp_path / "Model.m").write_text("function [soc, z] = Model(X, z)\nsoc = nowhere(X);\nend\n")
    with pytest.raises(InputError, match=r"whose model fails .*nowhere"):
        score_submission(tmp_path / "Model.m", logs, CAPACITY)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def Model(X, z=None):\n    return 1 / 0, z\n", "ZeroDivisionError"),
        ("def Model(X, z=None):\n    return float('nan'), z\n", "no number"),
        ("x = 1\n", "whose model fails"),
    ],
)
def test_refused(tmp_path, text, said):
    (tmp_path / "Model.py").write_text(text)
    with pytest.raises(InputError, match=said):
        score_submission(tmp_path / "Model.py", [(drive(0.1), 1.0)], CAPACITY)
    with pytest.raises(InputError, match="no file"):
        score_submission(tmp_path / "None.py", [(drive(0.1), 1.0)], CAPACITY)
    with pytest.raises(InputError, match="no log"):
        score_submission(tmp_path / "Model.py", [], CAPACITY)


def test_through_the_command(tmp_path, counter, capsys):
    log = drive(0.5)
    rows = zip(log.time_s, log.current_A, log.voltage_V, log.temperature_C, strict=True)
    text = ["time_s,current_A,voltage_V,temperature_C"]
    text += [",".join(f"{v:.6f}" for v in row) for row in rows]
    place = tmp_path / "drive.csv"
    place.write_text("\n".join(text) + "\n")
    asked = ["benchmark", "score", str(counter), "--reference-capacity-ah", "2", "--json"]
    assert main([*asked, "--log", f"{place}@soc0=1"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["cases"]["drives"] == pytest.approx(0.0, abs=1e-3)
    assert main([*asked, "--log", str(place)]) == 2
    assert "LOG@soc0=1" in capsys.readouterr().err
    assert main(asked) == 2
    assert "without a file, --log" in capsys.readouterr().err


@pytest.mark.slow
def test_an_hour_put_before_a_measured_drive_costs_at_most_two_points(real_data, tmp_path):
    """Of a late start, whose hour has no current at the voltage of a row under load."""
    model = stock_model("nca-18650")
    write(Export(model, 1.0), str(tmp_path / "Model.py"))
    log = read_log(real_data / "panasonic_18650pf" / "drive_p25_us06.csv.gz", check_sign=False)
    log = resample(log, 1.0)
    soc = 1.0 - log.counted_charge_Ah() / 2.9
    first, last = (int(np.argmax(soc < level)) for level in (0.62, 0.5))
    log, begins = log.part(first, last), float(soc[first])  # an hour costs seconds
    found = score_submission(tmp_path / "Model.py", [(log, begins)], 2.9)
    names = {"__name__": "submitted"}
    exec((tmp_path / "Model.py").read_text(), names)
    soc = begins - log.counted_charge_Ah() / 2.9
    assert [run.change for run in found.runs if run.case == "late starts"] == ["from 60%"]
    for run in found.runs:
        if run.case == "late starts":
            late = log.part(int(np.argmax(soc < float(run.change[5:-1]) / 100)), len(log))
            rows = np.column_stack([-late.current_A, late.voltage_V, late.temperature_C])
            alone, _ = names["Model"](rows)
            plain = 100 * np.sqrt(np.mean((alone - soc[-len(late) :]) ** 2))
            assert run.rmse <= plain + 2.0, run.change
