"""`export --submission`: the fixed step as one file of NumPy; rows that were put before a log."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from cellwise.cell.protocol import DriveProfile, run_protocol
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.options import Asked
from cellwise.estimate.replay import replay
from cellwise.export.matlab import Translation
from cellwise.export.package import Export
from cellwise.export.submission import matlab_text, submission_text, write
from cellwise.logs.cell_log import resample
from cellwise.logs.reading import read_log

DT_S = 10.0
needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)


def submitted(export):
    """What the file defines."""
    names = {"__name__": "submitted"}
    exec(compile(submission_text(export), "submitted.py", "exec"), names)
    return names


def drive(model, soc0, hours, rate=0.5, dt_s=DT_S):
    """A load that never rests."""
    rng = np.random.default_rng(3)
    rows = int(3600.0 * hours / dt_s)
    current = model.capacity_Ah * np.repeat(rate * rng.uniform(0.2, 1.0, rows // 6 + 1), 6)[:rows]
    steps = [DriveProfile(time_s=dt_s * np.arange(1.0, rows + 1), current_A=current)]
    return run_protocol(model, steps, soc0, dt_s, 25.0).part(1, rows + 1)


def measured(log, rng=None):
    """Rows as a bench hands them: charge positive, volt, degC."""
    noise = 0.0 if rng is None else 0.001 * rng.standard_normal(len(log))
    warm = np.full(len(log), 25.0) if log.temperature_C is None else log.temperature_C
    return np.column_stack([-log.current_A, log.voltage_V + noise, warm])


@needs_compiler
def test_it_says_what_replay_says():
    export = Export(stock_model("nmc-18650"), DT_S)
    log = drive(export.model, 0.8, 60 * DT_S / 3600.0)
    is_as_replayed(export, log)
    assert len(samples_of(export.model, log, DT_S).records) == 60


def is_as_replayed(export, log):
    """From a start that nobody knows."""
    trace = replay(export.model, log, "firmware", 0.5, soc0_std=0.3).trace
    soc, _ = submitted(export)["Model"](measured(log))
    np.testing.assert_allclose(soc, trace.soc, rtol=0.0, atol=1e-6)


TEN_LOGS = {
    "panasonic_18650pf/drive_p25_us06": "nca-18650", "plett_a123/dyn_p25_s1": "lfp-26650",
    "panasonic_18650pf/drive_n20_la92": "nca-18650", "plett_a123/dyn_n15_s2": "lfp-26650",
    "lg_18650hg2/drive_mixed4_p40_562": "nmc-18650", "lipo_5450/c1_cycle01": "lipo-pouch",
    "lg_18650hg2/drive_us06_n20_610": "nmc-18650", "lipo_5450/c3_cycle48": "lipo-pouch",
    "nissan_leaf/cap_2c_p23": "lmo-pouch", "nissan_leaf/hppc_p25": "lmo-pouch",
}  # fmt: skip


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("path", TEN_LOGS)
def test_of_ten_measured_logs_it_says_what_replay_says(real_data, path):
    """From end to end."""
    export = Export(stock_model(TEN_LOGS[path]), DT_S)
    log = read_log(real_data / f"{path}.csv.gz", check_sign=False)
    is_as_replayed(export, resample(log, DT_S))


def by_octave(export, rows, folder):
    """SOC of rows by the MATLAB file, all but the last three together."""
    (folder / "Model.m").write_text(matlab_text(export))
    savemat(folder / "rows.mat", {"X": rows})
    code = (
        "load('rows.mat'); [a, z] = Model(X(1:end-3, :)); soc = a;"
        "for k = size(X, 1) - 2:size(X, 1), [b, z] = Model(X(k, :), z); soc(end + 1) = b; end;"
        "save('-v7', 'soc.mat', 'soc')"
    )
    command = ["octave-cli", "--no-init-file", "--eval", code]
    subprocess.run(command, cwd=folder, capture_output=True, check=True)
    return loadmat(folder / "soc.mat")["soc"].ravel()


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no GNU Octave")
@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("nmc-18650", 60),
        *(
            pytest.param(name, 60, marks=pytest.mark.slow)
            for name in ("nca-18650", "lmo-pouch", "lfp-26650", "lipo-pouch")
        ),
    ],
)
def test_matlab_says_what_numpy_says(name, rows, tmp_path):
    """With noise, a reading that is missing, a jump of the voltage, and an hour put before it."""
    export = Export(stock_model(name), DT_S)
    log = drive(export.model, 0.8, rows * DT_S / 3600.0, rate=1.0)
    seen = measured(log, np.random.default_rng(2))
    seen[20, 1], seen[25, 0], seen[30, 2] = np.nan, np.nan, np.nan
    seen[40:45, 1] += 0.4
    padding = np.tile([0.0, seen[0, 1], 25.0], (20, 1))
    whole = np.concatenate([padding, seen])
    soc, _ = submitted(export)["Model"](whole)
    np.testing.assert_allclose(by_octave(export, whole, tmp_path), soc, atol=1e-6)


def test_what_matlab_has_no_word_for_is_refused():
    """A call that changes something behind `and`, which may not come to it; another statement."""
    sources = (
        "def f(x):\n    x.a = F(1.0)\n    return True\n"
        "def g(x):\n    b = x.a > F(0.0) and f(x)\n    return b\n",
        "def g(x):\n    x.a += F(1.0)\n",
    )
    for source in sources:
        functions = {node.name: node for node in ast.parse(source).body}
        with pytest.raises(ValueError, match=r"no MATLAB|call that changes"):
            list(Translation(functions, {}, {}).texts())


def test_rows_together_are_rows_one_by_one():
    names = submitted(Export(stock_model("nmc-18650"), DT_S))
    rows = measured(drive(stock_model("nmc-18650"), 0.7, 0.05))
    together, _ = names["Model"](rows)
    z, single = None, []
    for row in rows:
        soc, z = names["Model"](row, z)
        single.append(soc)
    assert together.tolist() == single


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nmc-18650"])
def test_an_hour_put_before_a_log_is_no_rest(name):
    """At most two points worse than without it; taken for a rest it is far off."""
    model = stock_model(name)
    log = drive(model, 0.6, 0.25, rate=2.0)
    log = log.part(int(np.argmax(log.current_A)), len(log))  # the hour has a low voltage
    rows = measured(log, np.random.default_rng(1))
    truth = log_soc(model, log)
    padding = np.tile([0.0, rows[0, 1], 25.0], (int(3600.0 / DT_S), 1))
    names = submitted(Export(model, DT_S))
    plain = error_at_end(names, rows, truth)
    padded = error_at_end(names, np.concatenate([padding, rows]), truth)
    names["PADDED_S"] = np.inf
    taken_for_rest = error_at_end(names, np.concatenate([padding, rows]), truth)
    assert padded <= plain + 0.02
    assert taken_for_rest > padded + 0.02


def log_soc(model, log):
    """True SOC of a part of a drive from 0.6."""
    whole = drive(model, 0.6, 0.25, rate=2.0)
    soc = 0.6 - np.cumsum(whole.current_A) * DT_S / (3600.0 * model.capacity_Ah)
    return soc[-len(log) :]


def error_at_end(names, rows, truth):
    """RMS of the SOC error over the log."""
    soc, _ = names["Model"](rows)
    return float(np.sqrt(np.mean((soc[-truth.size :] - truth) ** 2)))


def test_the_command_writes_a_file_that_runs_without_cellwise(tmp_path):
    place = tmp_path / "model.py"
    asked = ["--model", "nmc-18650", "--dt", "1", "--submission", str(place)]
    assert main(["export", *asked]) == 0
    code = "import model; print(model.Model([-1.0, 3.7, 25.0])[0], 'cellwise' in sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path += {sys.path[1:]!r}; {code}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    soc, known = ran.stdout.split()
    assert 0.0 < float(soc) < 1.0
    assert known == "False"


def test_a_step_without_a_bank_is_refused(tmp_path):
    lean = Export(stock_model("nmc-18650"), 1.0, asked=Asked(wide=False))
    with pytest.raises(InputError, match="bank"):
        write(lean, str(tmp_path / "model.py"))
