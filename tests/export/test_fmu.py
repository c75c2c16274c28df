"""export --fmu: an importer of FMI 3.0 steps it to the bits of Python."""

from __future__ import annotations

import shutil
import subprocess
import time
import zipfile

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.estimate.fixed.stepper import numba_stepper, start_state
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.firmware import need_package
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from firmware_cases import full_model, noisy_samples

fmpy = pytest.importorskip("fmpy", reason="no fmpy: pip install fmpy")
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
STEPS = 100_000


@pytest.fixture
def exported(export, tmp_path):
    """An FMU as the command writes it."""

    def run(model, *more):
        export("--dt", 0.5, "--fmu", tmp_path / "out.fmu", *more, model=model)
        return tmp_path / "out.fmu"

    return run


class Instance:
    """An FMU in fmpy's lower layer: set, step, get."""

    def __init__(self, place, folder, **start):
        from fmpy.fmi3 import FMU3Slave

        described = fmpy.read_model_description(place)
        self.refs = {v.name: v.valueReference for v in described.modelVariables}
        self.fmu = FMU3Slave(
            guid=described.guid, unzipDirectory=fmpy.extract(place, folder),
            modelIdentifier=described.coSimulation.modelIdentifier, instanceName="one",
        )  # fmt: skip
        self.fmu.instantiate()
        self.set(**start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values):
        self.fmu.setFloat64([self.refs[n] for n in values], list(values.values()))

    def get(self, *names):
        return self.fmu.getFloat64([self.refs[n] for n in names])


@pytest.mark.parametrize("what", ["estimator", pytest.param("cell", marks=pytest.mark.slow)])
def test_an_importer_finds_it_valid_and_its_sources_compile_without_a_warning(
    exported, tmp_path, what
):
    from fmpy.validation import validate_fmu

    place = exported(full_model(), "--what", what)
    assert validate_fmu(str(place)) == []
    with zipfile.ZipFile(place) as archive:
        archive.extractall(tmp_path)
        assert any(n.startswith("binaries/x86_64-linux/") for n in archive.namelist())
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-fsyntax-only"]
    sources = sorted((tmp_path / "sources").glob("*.c"))
    done = subprocess.run(
        ["gcc", *flags, f"-I{need_package('fmpy')[0]}/c-code", *map(str, sources)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_estimator_has_the_bits_of_python_over_100_000_steps(exported, tmp_path):
    model = full_model()
    one = Instance(exported(model), tmp_path / "x", soc0=0.6, soc0_std=0.1)
    records = noisy_samples(STEPS)
    names = ("soc", "soc_std", "predicted_voltage_V", "innovation_V")
    ins = [one.refs[n] for n in ("current_A", "voltage_V", "temperature_C")]
    outs = [one.refs[n] for n in names]
    found = np.empty((STEPS, 4))
    status = np.empty(STEPS, dtype=np.uint32)
    values = [[float(r[k]) for k in range(3)] for r in records]
    for k in range(STEPS):
        one.fmu.setFloat64(ins, values[k])
        one.fmu.doStep(currentCommunicationPoint=0.5 * k, communicationStepSize=0.5)
        found[k] = one.fmu.getFloat64(outs)
        status[k] = one.fmu.getUInt32([one.refs["status"]])[0]
    stepper = numba_stepper(fixed_step_tables(model, 0.5))
    expected = stepper.rows(start_state(stepper, 0.6, 0.1), records)
    std = np.sqrt(expected["soc_variance"].astype(float))
    for k, wanted in enumerate((expected["soc"], std, expected["voltage_V"])):
        np.testing.assert_array_equal(found[:, k], wanted.astype(float))
    np.testing.assert_array_equal(found[:, 3], expected["innovation_V"].astype(float))
    np.testing.assert_array_equal(status, expected["status"])
    assert np.unique(status).size > 3  # not only the easy way through the step


@pytest.mark.slow
def test_the_cell_has_the_voltage_of_simulate(exported, tmp_path):
    model = curved_cell()
    place = exported(model, "--what", "cell")
    time_s = np.arange(4001) * 0.5
    current = np.where(time_s % 400 < 250, 2.0, -1.0)
    held = np.array([(t, i) for t, i in zip(time_s, current, strict=True)],
                    dtype=[("time", "f8"), ("current_A", "f8")])  # fmt: skip
    found = fmpy.simulate_fmu(
        str(place), stop_time=2000.0, output_interval=0.5, input=held, start_values={"soc0": 0.9}
    )
    # What is set before a step flows during it: row k + 1 has the current of row k.
    log = CellLog(time_s, np.concatenate([[0.0], current[:-1]]), np.full(4001, 3.7))
    wanted = simulate(model, log, 0.9)
    assert np.max(np.abs(found["voltage_V"] - wanted.voltage_V)) < 1e-4
    assert np.max(np.abs(found["soc"] - wanted.soc)) < 1e-6
    assert not np.any(found["status"])


@pytest.mark.slow
def test_a_state_is_kept_and_set_again_and_steps_may_be_longer_than_a_sample(exported, tmp_path):
    low_V, high_V = curved_cell().ocv_V.min(), curved_cell().ocv_V.max()
    more = ["--remaining", low_V + 0.1, "--power", 10, "--voltage-limits", low_V, high_V]
    more += ["--current-limits", 10, 5]
    one = Instance(exported(curved_cell(), *more), tmp_path / "x", soc0=0.8)
    one.set(current_A=1.0, voltage_V=3.8)
    one.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=10.0)
    kept = one.fmu.serializeFMUState(one.fmu.getFMUState())
    names = ("soc", "soc_std", "discharge_W", "remaining_low_s", "remaining_s")
    before = one.get(*names)
    assert before[2] > 0
    assert 0 < before[3] < before[4]
    one.fmu.doStep(currentCommunicationPoint=10.0, communicationStepSize=100.0)
    after = one.get(*names)
    assert after[0] < before[0]
    one.fmu.setFMUState(one.fmu.deserializeFMUState(kept))
    assert one.get(*names) == before
    for k in range(100):
        one.fmu.doStep(currentCommunicationPoint=10.0 + k, communicationStepSize=1.0)
    assert one.get(*names) == after


def test_another_importer_finds_the_same_and_another_token_is_refused(exported, tmp_path):
    loader = pytest.importorskip("fmuloader.fmi3", reason="no fmuloader: pip install fmuloader")
    place = exported(curved_cell())
    one = Instance(place, tmp_path / "x", soc0=0.4)
    described = fmpy.read_model_description(str(place))
    other = loader.Fmi3Slave(place, model_identifier=described.coSimulation.modelIdentifier)
    with pytest.raises(Exception, match="nstantiat"):
        other.instantiate_co_simulation("other", instantiation_token="none")
    other.instantiate_co_simulation("other", instantiation_token=described.instantiationToken)
    other.set_float64([one.refs["soc0"]], [0.4])
    other.enter_initialization_mode(start_time=0.0)
    other.exit_initialization_mode()
    ins = [one.refs[n] for n in ("current_A", "voltage_V")]
    outs = [one.refs[n] for n in ("soc", "soc_std", "innovation_V")]
    for k, row in enumerate(noisy_samples(300)):
        values = [float(row["current_A"]), float(row["voltage_V"])]
        one.fmu.setFloat64(ins, values)
        other.set_float64(ins, values)
        one.fmu.doStep(currentCommunicationPoint=0.5 * k, communicationStepSize=0.5)
        other.do_step(0.5 * k, 0.5)
        assert list(other.get_float64(outs)) == list(one.fmu.getFloat64(outs))
    other.free_instance()


@pytest.mark.slow
def test_a_step_takes_at_most_a_microsecond_beside_the_importer(exported, tmp_path):
    one = Instance(exported(curved_cell()), tmp_path / "x", soc0=0.8)
    one.set(current_A=0.01, voltage_V=3.8)
    best = np.inf
    for k in range(5):
        began = time.perf_counter()
        one.fmu.doStep(currentCommunicationPoint=5e4 * k, communicationStepSize=5e4)
        best = min(best, time.perf_counter() - began)
    assert best / 1e5 < 1e-6
