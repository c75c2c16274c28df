"""The whole loop on measured drives: weeks of the C, a sketch, its cause, a patch, the C with it.

An effect comes to a measured cell at 25 degC. Two weeks before and two after leave a sketch each;
beside it `diagnose` sees the drives of the later weeks as full logs. SOC is judged on drives that
neither saw with the effect. The truth is what the tester counted.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from cellwise.diagnose import diagnose
from cellwise.diagnose.sketch_pictures import hidden, usual
from cellwise.diagnose.sketched import diagnose_sketch
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.sketch.sketcher import means_of
from cellwise.estimate.sketch.stored import read_sums
from cellwise.export.patch import patched_rows, taken
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from cellwise.logs.cell_log import resample
from cellwise.workflows.patching import patch_for, patch_from_sketch
from cellwise.workflows.sketches import with_pictures
from measured_models import LATER, LINEAGE, OWN, PAST, SketchBench, identify_once, rmse

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc"),
]
ONE_C = "cap_1c_p25_start_1"
JUDGED = ("nn", "hwfta", "cycle_4")
STARTS = ((1.0, 0.02, 0.0), (0.85, 0.15, 0.2))  # SOC, its deviation, share of the log not judged
OF_FULL, OF_NONE = 0.003, 0.002  # the issue's: of what full logs give, of what no patch gives
CASES = [
    (size, cause, times)
    for size in (1024, 256)
    for cause, times in (
        ("current_offset", 1.5),
        ("current_offset", 2.5),
        ("current_gain", 1.5),
        ("current_gain", 2.5),
        ("ohmic_resistance", 1.5),
        ("voltage_offset", 1.5),
    )
]


class LoopErrors(NamedTuple):
    """SOC RMSE without a patch, with that of full logs, with that of sketches; (runs,) each."""

    without: np.ndarray
    full: np.ndarray
    sketch: np.ndarray


class Loop(SketchBench):
    """The bench of sketches with a model from the cell's own tests, the C with patches beside."""

    def __init__(self, folder):
        super().__init__(folder)
        hppc, ocv, capacity = (
            read_log(folder / f"{n}.csv.gz") for n in ("hppc_p25", "ocv_c20_p25", ONE_C)
        )
        two = tuple(replace(self.drives[n], soc0=None) for n in OWN)
        tests = CellTests(hppc=hppc, ocv=ocv, capacity=capacity, drive=two)
        self.model = with_pictures(identify_once(tests, IdentifySettings(nominal_Ah=2.9))).model
        self.errors = cache(self.errors_of)
        self.of_full = cache(self.patch_of_full_logs)

    def tables(self, most):
        return self.target(most, True).stepper(1.0).tables

    def patch_of_full_logs(self, cause, size):
        """The block, or None where full logs name nothing that a patch holds."""
        seen = [means_of(hidden(self.drives[n], cause, size, self.model), 1.0) for n in LATER]
        found = diagnose(self.model, seen[:1], holdout=seen[1:], soc0=1.0)
        return none_if_refused(patch_for, found, self.model, self.tables(1024), 1)

    def found_in_sketches(self, most, cause, size):
        """Diagnosis of the bytes alone, the cell's own spread left out; the last sums."""
        past = read_sums(self.kept(most, PAST, health=True))
        later = read_sums(self.kept(most, LATER, cause, size, health=True))
        return diagnose_sketch(self.model, past, [later], LINEAGE), later

    def patch_of_sketches(self, most, cause, size):
        asked = *self.found_in_sketches(most, cause, size), self.model, 1
        return none_if_refused(patch_from_sketch, *asked)

    def errors_of(self, most, cause, times):
        """What the C makes of the effect, in order of :class:`LoopErrors`."""
        size = times * usual(self.model)[cause]
        blocks = None, self.of_full(cause, size), self.patch_of_sketches(most, cause, size)
        rows = []
        for name in JUDGED:
            plain = resample(self.drives[name], 1.0)
            flowed_Ah = np.cumsum(plain.known_current_A() * plain.interval_s) / 3600.0
            soc = 1.0 - flowed_Ah / self.model.capacity_Ah
            log = hidden(plain, cause, size, self.model)
            for soc0, std, unjudged in STARTS:
                from_row = int(unjudged * soc.size)
                runs = (self.soc_of(log, soc0, std, block) for block in blocks)
                rows.append([rmse((run - soc)[from_row:]) for run in runs])
        return LoopErrors(*np.array(rows).T)

    def soc_of(self, log, soc0, std, block):
        stepper = self.target(1024, True).stepper(1.0)
        memory = stepper.start_filter(11, soc0, std)
        records = samples_of(self.model, log, 1.0).records
        if block is None:
            return stepper.filter_rows(memory, records)["soc"].astype(float)
        patch = taken(block, stepper.tables)
        return patched_rows(stepper, patch, memory, records)["soc"].astype(float)


def none_if_refused(make, *asked):
    """The patch, as the command leaves it out where there is none."""
    try:
        return make(*asked)
    except InputError:
        return None


@pytest.fixture(scope="module")
def loop(real_data):
    return Loop(real_data / "panasonic_18650pf")


def marked():
    """Every case; what is missed is marked with its figure."""
    for case in CASES:
        why = NOT_AS_FULL.get(case)
        marks = pytest.mark.xfail(reason=why, strict=True) if why else ()
        yield pytest.param(*case, marks=marks, id="-".join(map(str, case)))


# The worst run; means of all runs without a patch, of full logs, of the sketch [points].
NOT_AS_FULL = {
    (1024, "current_offset", 1.5): "0.42 points worse; 1.9, 0.73, 0.81; 0.140 of 0.157 A",
    (1024, "current_offset", 2.5): "0.52 points worse; 2.1, 1.0, 1.4; 0.228 of 0.262 A",
    (1024, "current_gain", 1.5): "0.49 points worse; 2.8, 0.56, 0.64",
    (1024, "voltage_offset", 1.5): "0.55 points worse; 1.7, 0.57, 0.92; 20 of 30 mV",
    (256, "current_offset", 1.5): "0.53 points worse; 1.9, 0.73, 0.90; 0.136 of 0.157 A",
    (256, "current_gain", 1.5): "3.2 points worse; nothing is named",
    (256, "current_gain", 2.5): "1.9 points worse; nothing is named",
    (256, "voltage_offset", 1.5): "1.7 points worse; nothing is named",
}


@pytest.mark.parametrize(("most", "cause", "times"), list(marked()))
def test_a_patch_of_a_sketch_gives_the_soc_of_that_of_full_logs(loop, most, cause, times):
    errors = loop.errors(most, cause, times)
    assert np.mean(errors.full) < np.mean(errors.without)
    assert np.all(errors.sketch <= errors.full + OF_FULL)


@pytest.mark.parametrize(("most", "cause", "times"), CASES)
def test_a_patch_of_a_sketch_is_no_worse_than_none(loop, most, cause, times):
    errors = loop.errors(most, cause, times)
    assert np.all(errors.sketch <= errors.without + OF_NONE)


@pytest.mark.parametrize("most", [1024, 256])
@pytest.mark.parametrize("cause", ["current_offset", "ohmic_resistance"])
def test_a_large_size_is_read_in_full(loop, most, cause):
    """The residual that a cause makes weighs its own sketch down, but not its size."""
    size = 2.5 * usual(loop.model)[cause]
    found, _ = loop.found_in_sketches(most, cause, size)
    assert found.verdict == cause
    (value,) = found.causes[0].parameters.values()
    assert value == pytest.approx(size, rel=0.25)
