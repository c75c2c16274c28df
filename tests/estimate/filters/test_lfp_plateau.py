"""A123 (LFP with hysteresis): on the plateau a filter says that it does not know.

C/30 branches at 25 degC and drives of five temperatures, the sixth held out; four of the six in
turn (docs/measured.md has all). The tester's counter is the reference; the log's own current drifts
from it by up to 1.2 %.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.estimate.estimators import make_estimator
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.logs import read_log

REFERENCE_AH = 2.0725
CHAMBER_C = {"n25": -25.0, "n15": -15.0, "p05": 5.0, "p25": 25.0, "p35": 35.0, "p45": 45.0}
MORE = 0.003  # of SOC RMSE, a filter may lose against counting
HELD_OUT = ("n25", "n15", "p25", "p45")
# In the middle of the plateau; 30 points away on either side.
STARTS = ((0.65, -0.3), (0.5, 0.3), (0.5, -0.3))
PLATEAU_END = 0.2
BEYOND = "10 K colder than its data the model is 81 mV off, and claims 50: {}"

pytestmark = pytest.mark.slow


def each_temperature(**missed):
    """The temperatures; ``missed``: the reason where a figure falls short."""
    return [
        pytest.param(tag, marks=pytest.mark.xfail(strict=True, reason=missed[tag]))
        if tag in missed
        else tag
        for tag in HELD_OUT
    ]


@pytest.fixture(scope="module")
def held_out(real_data):
    """The model that has not seen a temperature, and the drive there, by its tag."""
    folder = real_data / "plett_a123"

    def log(name, warm, soc0):
        found = read_log(folder / f"{name}.csv.gz")
        return replace(found, name=name, temperature_C=np.full(len(found), warm), soc0=soc0)

    branches = tuple(log(f"ocv_p25_{part}", 25.0, None) for part in ("s1", "s3"))
    drives = {tag: log(f"dyn_{tag}_s1", warm, 1.0) for tag, warm in CHAMBER_C.items()}
    known = {}

    def one(tag):
        if tag not in known:
            others = tuple((drives[t], CHAMBER_C[t]) for t in CHAMBER_C if t != tag)
            tests = TestLogs(ocv=branches, drive=others)
            known[tag] = identify_cell(tests, IdentifySettings(nominal_Ah=2.07)).model
        return known[tag], drives[tag]

    return one


def rmse(error):
    return float(np.sqrt(np.mean(np.square(error))))


def truth_of(log):
    return 1.0 - (log.charge_Ah - log.charge_Ah[0]) / REFERENCE_AH


def loss(model, log, name, std):
    """SOC RMSE of a filter from the true start less that of counting."""
    ours, counted = (
        rmse(make_estimator(n, model).run(log, 1.0, s).soc - truth_of(log))
        for n, s in ((name, std), ("coulomb", 0.005))
    )
    return ours - counted


def from_the_middle(model, log, name):
    """Share of rows inside two sigma over all starts, and the worst RMSE past the plateau."""
    inside, past = [], []
    for at_soc, wrong in STARTS:
        truth = truth_of(log)
        begin = int(np.argmax(truth < at_soc))
        begin += int(np.argmax(log.current_A[begin:] > 1.0))
        truth = truth[begin:]
        part = log.part(begin, len(log))
        trace = make_estimator(name, model).run(part, float(truth[0]) + wrong, 0.15)
        error = trace.soc - truth
        inside.append(np.mean(np.abs(error) < 2.0 * trace.soc_std))
        past.append(rmse(error[truth < PLATEAU_END]))
    return float(np.mean(inside)), max(past)


@pytest.mark.parametrize("name", ["ekf", "ukf", "adaptive"])
@pytest.mark.parametrize("tag", each_temperature(n25=BEYOND.format("31 to 41 % of rows inside")))
def test_wrong_on_the_plateau_the_band_holds_the_truth(held_out, tag, name):
    assert from_the_middle(*held_out(tag), name)[0] > 0.95


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize(
    "tag",
    each_temperature(
        n25=BEYOND.format("10 %"),
        n15="resistances of -25 and 5 degC are not those of -15: 5.4 % (EKF), 5.9 % (UKF)",
        p45="the log's own current is 0.7 % off: 2.7 % (EKF), 2.4 % (UKF)",
    ),
)
def test_wrong_on_the_plateau_it_is_within_two_points_past_its_end(held_out, tag, name):
    assert from_the_middle(*held_out(tag), name)[1] < 0.02


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize(
    "tag", each_temperature(n25=BEYOND.format("2.0 (EKF) and 3.2 (UKF) points"))
)
def test_a_true_start_is_not_pulled_away(held_out, tag, name):
    model, log = held_out(tag)
    assert loss(model, log, name, 0.005) < MORE


@pytest.mark.parametrize("tag", each_temperature(n25=BEYOND.format("2.0 points")))
def test_a_true_start_that_nobody_vouches_for_is_not_pulled_away(held_out, tag):
    model, log = held_out(tag)
    assert loss(model, log, "ekf", 0.15) < MORE


@pytest.mark.parametrize("tag", each_temperature(n25="0.52 points more than the EKF"))
def test_adaptive_is_hardly_worse_than_the_ekf(held_out, tag):
    model, log = held_out(tag)
    assert loss(model, log, "adaptive", 0.005) < loss(model, log, "ekf", 0.005) + 0.002
