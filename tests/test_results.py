"""What a person does first with any result: its columns, a data frame, a picture, its figures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import cellwise as cw
from cellwise.estimate.tune_noise import NoiseTuning
from cellwise.history.ageing import AgeingHistory, AgeingRecord
from cellwise.history.trend import Trend
from cellwise.pack.pack_estimate import UNKNOWN, CellsEstimate, PackEstimate
from cellwise.plotting import Plottable
from diagnosis_cases import diagnosis
from example_cells import curved_cell

ROWS = 2400


@cache
def drive():
    return cw.load_dataset("nmc_drive_b").part(0, ROWS)


@cache
def replayed():
    cell = replace(curved_cell(), chemistry="NMC")
    truth = {"reference_soc0": 0.997, "reference_capacity_Ah": 5.15}
    return cw.replay(cell, drive(), soc0=0.7, power=True, **truth)


def life():
    one = AgeingRecord(drive(), 3.0, 0.1, 1.0, 0.01, 0.0, 0.0, 1.1, 0.02, 1.0, 0.1, True, "counted")
    trend = Trend(np.array([1.0, 0.97]), np.array([0.002, 0.01]), None)
    return AgeingHistory(curved_cell(), (one, one), "days", np.array([0.0, 30.0]), trend)


def pack():
    names = ("cell_01", "cell_02", "cell_03")
    fields = CellsEstimate.__dataclass_fields__
    cells = CellsEstimate(**{name: np.array([0.5, 0.6, 0.7]) for name in fields})
    day = SimpleNamespace(log=SimpleNamespace(names=names))
    return PackEstimate(curved_cell(), (day,), cells, UNKNOWN, None, (), (), None)


def tuned():
    noise = cw.Noise.of_model(curved_cell())
    return NoiseTuning(noise, noise, ("drive",), (1.0,), (1.0,), (0.0, 0.0))


RESULTS = {
    "trace": lambda: replayed().trace,
    "power": lambda: replayed().power,
    "forecast": lambda: cw.forecast(curved_cell(), replayed()),
    "diagnosis": lambda: diagnosis("current_offset"),
    "life": life,
    "pack": pack,
    "noise": tuned,
}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_is_a_data_frame(name):
    frames = pytest.importorskip("pandas")
    result = RESULTS[name]()
    table, frame = result.table(), result.to_pandas()
    assert list(frame.columns) == list(table)
    assert len(frame) > 0
    frames.testing.assert_frame_equal(frame, frames.DataFrame(table))


@pytest.mark.parametrize("name", ["forecast", "life", "pack"])
def test_what_has_an_axis_has_a_plot(name):
    figures = pytest.importorskip("matplotlib.figure")
    result = RESULTS[name]()
    assert isinstance(result, Plottable)
    drawn = result.plot(figure=figures.Figure())
    assert len(drawn.axes) == len(result.panels()[1])


def test_a_diagnosis_without_a_cause_is_an_empty_frame():
    found = SimpleNamespace(causes=())
    assert cw.Diagnosis.columns(found)["cause"] == []


def test_soc_and_error_are_at_hand_and_an_error_is_estimate_less_truth():
    run = replayed()
    np.testing.assert_array_equal(run.soc, run.trace.soc)
    np.testing.assert_array_equal(run.soc_std, run.trace.soc_std)
    np.testing.assert_array_equal(run.error, run.soc - run.reference_soc)
    np.testing.assert_array_equal(run.time_s, drive().time_s)
    assert run.rmse == pytest.approx(float(np.sqrt(np.mean(run.error**2))))
    assert run.rmse == run.to_dict()["soc_rmse"]


def test_a_start_that_is_too_low_is_a_negative_error():
    truth = {"reference_soc0": 0.997, "reference_capacity_Ah": 5.15}
    counted = cw.replay(curved_cell(), drive(), "coulomb", soc0=0.7, **truth)
    assert counted.error[0] == pytest.approx(0.7 - 0.997)


def test_without_a_truth_there_is_no_error():
    run = cw.replay(curved_cell(), drive(), "coulomb", soc0=0.7)
    assert run.error is None
    assert run.rmse is None


def test_a_residual_is_measured_less_model():
    found = cw.simulate(curved_cell(), drive(), 0.9)
    np.testing.assert_array_equal(found.residual_V, drive().voltage_V - found.voltage_V)
    assert found.rmse_V == found.to_dict()["rmse_V"]
    mean_V = float(np.mean(found.residual_V))
    assert found.to_dict()["mean_error_V"] == pytest.approx(mean_V)  # as outside programs know it
