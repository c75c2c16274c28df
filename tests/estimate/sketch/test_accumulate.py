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
from cellwise.estimate.sketch.stored import MAGIC, empty_sketch, read_sums, sealed
from cellwise.export.firmware import HostLibrary
from cellwise.logs import read_log
from example_cells import curved_cell
from firmware_cases import compile_and_run, full_model, noisy_samples

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
FULL = 1e-4  # variance of a SOC that is known


def sketched(stepper, samples, sketch=None):
    """State and sketch after samples from a full cell."""
    state = stepper.state()
    stepper.begin(state, 1.0, FULL)
    sketch = empty_sketch(stepper) if sketch is None else sketch
    stepper.sketch_rows(state, sketch, samples)
    return state, sketch


@pytest.fixture(scope="module")
def drive(real_data):
    """A measured drive of the stock model's cell: tables and samples."""
    model = stock_model("nca-18650")
    log = read_log(real_data / "panasonic_18650pf" / "drive_p25_us06.csv.gz")
    return fixed_step_tables(model, 1.0, sketch=1024), samples_of(model, log, 1.0).records


@needs_gcc
def test_a_measured_drive_gives_the_same_bits_in_c(drive):
    pytest.importorskip("cffi")
    tables, samples = drive
    ours, theirs = (sketched(s, samples) for s in (numba_stepper(tables), HostLibrary(tables)))
    assert ours[0].tobytes() == theirs[0].tobytes()
    assert ours[1].tobytes() == theirs[1].tobytes()
    assert ours[1]["rows"][0] > 400
    assert ours[1].nbytes <= 1024


@needs_gcc
def test_every_effect_and_readings_of_no_cell_give_the_same_bits(drive):
    pytest.importorskip("cffi")
    tables = fixed_step_tables(full_model(), 1.0, sketch=1024)
    samples = noisy_samples(5000)
    ours, theirs = (sketched(s, samples) for s in (numba_stepper(tables), HostLibrary(tables)))
    assert ours[1].tobytes() == theirs[1].tobytes()


def test_the_filter_steps_as_without_a_sketch(drive):
    tables, samples = drive
    plain = numba_stepper(fixed_step_tables(stock_model("nca-18650"), 1.0))
    state = plain.state()
    plain.begin(state, 1.0, FULL)
    plain.rows(state, samples)
    assert sketched(numba_stepper(tables), samples)[0].tobytes() == state.tobytes()


def test_sums_keep_their_last_percent_over_a_thousand_hours(drive):
    """The same drive again and again adds the same again and again."""
    tables, samples = drive
    stepper = numba_stepper(tables)
    once = sketched(stepper, samples)[1]
    times = int(1000 * 3600 / samples.size) + 1
    many = empty_sketch(stepper)
    for _ in range(times):
        sketched(stepper, samples, many)
    assert many["segments"][0] == times
    whole = [(k["sum"][0] - k["carry"][0].astype(float)) for k in (once, many)]
    assert whole[1] == pytest.approx(times * whole[0], rel=1e-5, abs=1e-3 * np.ptp(whole[0]))


def test_a_gap_ends_a_simulation_and_a_missing_voltage_does_not(drive):
    tables, samples = drive
    stepper = numba_stepper(tables)
    silent, late = samples.copy(), samples.copy()
    silent["voltage_V"][1000:1003] = np.nan
    late["sequence"][1000:] += 50
    whole, with_silence, ended = (sketched(stepper, s)[1] for s in (samples, silent, late))
    assert with_silence["rows"][0] == whole["rows"][0]
    assert with_silence["segments"][0] == 1
    # It begins again where the filter knows the SOC, and the block of the gap is lost.
    assert ended["rows"][0] == 99 if ended["segments"][0] == 1 else ended["rows"][0] < 428


def test_a_constant_load_is_simulated_exactly():
    """Branches of a cell at constant current follow their exponentials; so does the mean."""
    model = curved_cell()
    tables = fixed_step_tables(model, 1.0, sketch=1024)
    samples = np.zeros(41, dtype=INPUT)
    samples["current_A"], samples["voltage_V"] = 1.0, 3.8
    samples["sequence"] = np.arange(41)
    sketch = sketched(numba_stepper(tables), samples)[1]
    assert sketch["blocks"][0] == 4
    assert sketch["soc"][0] == pytest.approx(1.0 - 40.0 / 3600.0 / model.capacity_Ah, abs=2e-4)


@needs_gcc
def test_what_is_sealed_on_the_target_is_read(drive, tmp_path):
    """Header and CRC of the C are those of Python; a bit that fell over is noticed."""
    tables, samples = drive
    stepper = numba_stepper(tables)
    sketch = sketched(stepper, samples)[1]
    (tmp_path / "sketch.bin").write_bytes(sketch.tobytes())
    block = sealed(sketch, tables)
    program = """
    #include <stdio.h>
    #include "cellwise_store.h"
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
    source = tmp_path / "sketch.bin"
    program = program.replace('#include "cellwise_store.h"', '#include "cellwise_store.c"')
    compile_and_run(tables, tmp_path, program, run=[str(source)])
    assert source.read_bytes() == block
    assert read_sums(block).rows == sketch["rows"][0]
    for at in range(0, len(block), 37):
        wrong = bytearray(block)
        wrong[at] ^= 4
        with pytest.raises(InputError):
            read_sums(bytes(wrong))
    assert int.from_bytes(block[:4], "little") == MAGIC


def test_what_has_no_room_or_no_sums_is_refused(drive):
    tables, _ = drive
    with pytest.raises(InputError, match="bytes for a sketch"):
        fixed_step_tables(curved_cell(), 1.0, sketch=256)
    empty = empty_sketch(numba_stepper(tables))
    with pytest.raises(InputError, match="nothing that was summed"):
        read_sums(sealed(empty, tables))
    assert sketch_type(tables.options).itemsize <= 1024
