"""A sketch: the same bits in Python and C, sums that lose nothing, what is refused."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from cellwise.cell.stock import stock_model
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import INPUT, sketch_type
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.sketch.sketcher import means_of
from cellwise.estimate.sketch.stored import empty_sketch, read_sums, sealed
from cellwise.export.firmware import HostLibrary
from cellwise.logs import read_log
from example_cells import curved_cell
from firmware_cases import compile_and_run, full_model, noisy_samples

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
FULL = 1e-4  # variance of a SOC that is known
SIZES = (256, 1024)


def sketched(stepper, samples, sketch=None):
    """State and sketch after samples from a full cell."""
    state = stepper.state()
    stepper.begin(state, 1.0, FULL)
    sketch = empty_sketch(stepper, 7) if sketch is None else sketch
    stepper.rows_beside("sketch_rows", state, sketch, samples)
    return state, sketch


def sums_of(sketch):
    """The sums of a sketch, of all simulations."""
    parts = [n for n in ("sum", "part") if n in sketch.dtype.names]
    return sum(sketch[n][0].astype(float) for n in parts)


@pytest.fixture(scope="module")
def drive(real_data):
    """A measured drive of the stock model's cell: model, samples."""
    model = stock_model("nca-18650")
    log = read_log(real_data / "panasonic_18650pf" / "drive_p25_us06.csv.gz")
    return model, samples_of(model, means_of(log, 1.0), 1.0).records


@pytest.fixture(scope="module")
def tables(drive):
    return fixed_step_tables(drive[0], 1.0, sketch=1024)


@needs_gcc
@pytest.mark.parametrize("most", SIZES)
def test_a_measured_drive_gives_the_same_bits_in_c(drive, most):
    pytest.importorskip("cffi")
    model, samples = drive
    tables = fixed_step_tables(model, 1.0, sketch=most)
    ours, theirs = (sketched(s, samples) for s in (numba_stepper(tables), HostLibrary(tables)))
    assert ours[0].tobytes() == theirs[0].tobytes()
    assert ours[1].tobytes() == theirs[1].tobytes()
    assert ours[1]["rows"][0] > 250
    assert ours[1].nbytes <= most


@needs_gcc
@pytest.mark.parametrize("most", SIZES)
def test_every_effect_and_readings_of_no_cell_give_the_same_bits(most):
    pytest.importorskip("cffi")
    tables = fixed_step_tables(full_model(), 1.0, sketch=most)
    samples = noisy_samples(5000)
    ours, theirs = (sketched(s, samples) for s in (numba_stepper(tables), HostLibrary(tables)))
    assert ours[1].tobytes() == theirs[1].tobytes()
    assert ours[1].nbytes <= most


def test_the_filter_steps_as_without_a_sketch(drive, tables):
    model, samples = drive
    plain = numba_stepper(fixed_step_tables(model, 1.0))
    state = plain.state()
    plain.begin(state, 1.0, FULL)
    plain.rows(state, samples)
    assert sketched(numba_stepper(tables), samples)[0].tobytes() == state.tobytes()


@pytest.mark.parametrize("most", SIZES)
def test_sums_keep_their_last_percent_over_a_thousand_hours(drive, most):
    """The same drive again and again adds the same again and again, where nothing fades."""
    model, samples = drive
    tables = fixed_step_tables(model, 1.0, sketch=most)
    tables.constants["sketch_fade"] = 0.0
    stepper = numba_stepper(tables)
    once = sketched(stepper, samples)[1]
    times = int(1000 * 3600 / samples.size) + 1
    many = empty_sketch(stepper)
    for turn in range(times):
        later = samples.copy()
        later["sequence"] += (turn + 1) * 2 * samples.size
        sketched(stepper, later, many)
    assert many["segments"][0] == times
    assert sums_of(many) == pytest.approx(times * sums_of(once), rel=0.01)


def test_what_was_summed_fades_with_use(drive, tables):
    """A thousand hours after a drive it counts for 1/e of what it did."""
    _, samples = drive
    stepper = numba_stepper(tables)
    sketch = sketched(stepper, samples)[1]
    before = sums_of(sketch)
    idle = np.zeros(40 * 3600, dtype=INPUT)
    idle["voltage_V"], idle["temperature_C"] = np.nan, 25.0
    for turn in range(25):
        idle["sequence"] = np.arange(idle.size) + (turn + 2) * 2 * idle.size
        sketched(stepper, idle, sketch)
    assert sums_of(sketch) == pytest.approx(np.exp(-1.0) * before, rel=0.03)


def test_a_gap_ends_a_simulation_and_a_missing_voltage_does_not(drive, tables):
    _, samples = drive
    stepper = numba_stepper(tables)
    silent, late = samples.copy(), samples.copy()
    silent["voltage_V"][1000:1015] = np.nan
    late["sequence"][1000:] += 50
    whole, with_silence, ended = (sketched(stepper, s)[1] for s in (samples, silent, late))
    assert with_silence["rows"][0] == whole["rows"][0] - 1
    assert with_silence["segments"][0] == 1
    # It begins again only where the filter knows the SOC.
    assert ended["rows"][0] < whole["rows"][0]


def test_a_constant_load_is_simulated_exactly():
    """Every branch of a cell at constant current follows its exponential."""
    model = curved_cell()
    tables = fixed_step_tables(model, 1.0, sketch=1024)
    samples = np.zeros(61, dtype=INPUT)
    samples["current_A"], samples["voltage_V"] = 1.0, 3.8
    samples["sequence"] = np.arange(61)
    sketch = sketched(numba_stepper(tables), samples)[1]
    assert sketch["blocks"][0] == 4
    assert sketch["soc"][0] == pytest.approx(1.0 - 60.0 / 3600.0 / model.capacity_Ah, abs=2e-4)
    for r_ohm, tau_s, v in (
        (model.r1_ohm, model.tau1_s, sketch["v1_V"][0]),
        (model.r2_ohm, model.tau2_s, sketch["v2_V"][0]),
    ):
        end = float(r_ohm[-1, -1]) * (1.0 - np.exp(-60.0 / float(tau_s[-1, -1])))
        assert v == pytest.approx(end, rel=0.03)


@needs_gcc
@pytest.mark.parametrize("most", SIZES)
def test_what_is_sealed_on_the_target_is_read(drive, tmp_path, most):
    """Header and CRC of the C are those of Python; a bit that fell over is noticed."""
    model, samples = drive
    tables = fixed_step_tables(model, 1.0, sketch=most)
    stepper = numba_stepper(tables)
    sketch = sketched(stepper, samples)[1]
    source = tmp_path / "sketch.bin"
    source.write_bytes(sketch.tobytes())
    block = sealed(sketch, tables)
    program = """
    #include <stdio.h>
    #include "cellwise_store.c"
    int main(int argc, char **argv)
    {
        cellwise_sketch k;
        FILE *file = fopen(argv[argc - 1], "rb");
        const size_t got = fread(&k, sizeof k, 1u, file);
        (void)fclose(file);
        cellwise_seal_sketch(&k);
        file = fopen(argv[argc - 1], "wb");
        const size_t put = fwrite(&k, sizeof k, 1u, file);
        (void)fclose(file);
        return ((got == 1u) && (put == 1u)) ? 0 : 1;
    }
    """
    compile_and_run(tables, tmp_path, program, run=[str(source)])
    assert source.read_bytes() == block
    found = read_sums(block)
    assert (found.rows, found.unit) == (sketch["rows"][0], 7)
    assert found.temperature_C == pytest.approx(samples["temperature_C"].mean(), abs=2.0)
    for at in range(0, len(block), 37):
        wrong = bytearray(block)
        wrong[at] ^= 4
        with pytest.raises(InputError):
            read_sums(bytes(wrong))


def test_what_has_no_room_or_no_sums_is_refused(drive, tables):
    with pytest.raises(InputError, match="bytes for a sketch"):
        fixed_step_tables(curved_cell(), 1.0, sketch=200)
    empty = empty_sketch(numba_stepper(tables))
    with pytest.raises(InputError, match="nothing that was summed"):
        read_sums(sealed(empty, tables))
    assert sketch_type(fixed_step_tables(full_model(), 1.0, sketch=256).options).itemsize == 256
