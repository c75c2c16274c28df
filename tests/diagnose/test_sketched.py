"""Causes from the bytes of sketches alone, hidden in two weeks of measured drives."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellwise.cell.model_file import write_model
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.diagnose.sketch_pictures import (
    NAMED,
    hidden,
    make_pictures,
    pictures_in,
    usual,
)
from cellwise.diagnose.sketched import diagnose_fleet, diagnose_sketch
from cellwise.errors import InputError
from cellwise.estimate.sketch.sketcher import Sketcher, means_of
from cellwise.estimate.sketch.stored import read_sums
from cellwise.export.firmware import Firmware
from cellwise.logs import read_log

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
STOCK, LINEAGE = "nca-18650", "panasonic"
OWN = ("cycle_2", "cycle_3")
PAST = ("nn", "hwfta", "cycle_4", "cycle_2")
LATER = ("us06", "hwftb", "cycle_3")
DAYS = 14  # a drive a day
SIZES = (1024, 256)
TIMES = 1.5  # the usual size of a cause
MISSED = {
    (1024, "current_offset"): "0.157 A: no cause above 0.4",
    (1024, "current_gain"): "8 %: probability 0.15",
    (1024, "voltage_offset"): "30 mV: probability 0.09",
    (256, "current_gain"): "8 %: probability 0.73",
    (256, "voltage_offset"): "30 mV: probability 0.68",
    (256, "hysteresis"): "41 mV: probability 0.78",
}


class Bench:
    """A measured cell: its model, its drives, and the C that keeps a sketch of them."""

    def __init__(self, folder):
        self.drives = {
            n: replace(read_log(folder / f"drive_p25_{n}.csv.gz"), soc0=1.0)
            for n in dict.fromkeys((*OWN, *PAST, *LATER))
        }
        self.model = make_pictures(stock_model(STOCK), [self.drives[n] for n in OWN])
        self.kept = cache(self.keep)

    def keep(self, most, names, cause="", size=0.0, unit=5):
        """The bytes that a target keeps of two weeks, each day from a full cell."""
        sketcher = Sketcher(Firmware(self.model, dt_s=1.0, sketch=most))
        sketch = sketcher.begin(unit)
        for day in range(DAYS):
            log = self.drives[names[day % len(names)]]
            log = hidden(log, cause, size, self.model) if cause else log
            sketcher.run(means_of(log, 1.0), sketch=sketch)
        return sketcher.bytes_of(sketch)


@pytest.fixture(scope="module")
def bench(real_data):
    return Bench(real_data / "panasonic_18650pf")


@pytest.mark.parametrize("most", SIZES)
def test_nothing_is_named_in_the_same_cell_on_other_drives(bench, most):
    past, later = (read_sums(bench.kept(most, n)) for n in (PAST, LATER))
    found = diagnose_sketch(bench.model, past, [later], LINEAGE)
    assert not found.causes
    assert found.verdict == "none"


def missed_marks():
    """Every size and cause; what is missed is marked with its figure."""
    for most in SIZES:
        for cause in NAMED:
            why = MISSED.get((most, cause))
            marks = pytest.mark.xfail(reason=why, strict=True) if why else ()
            yield pytest.param(most, cause, marks=marks, id=f"{most}-{cause}")


@pytest.mark.parametrize(("most", "cause"), missed_marks())
def test_a_hidden_cause_is_named_with_its_size(bench, most, cause):
    """The drives of the past are others, the cell took no part in what clean sketches differ by."""
    size = TIMES * usual(bench.model)[cause]
    past, later = bench.kept(most, PAST), bench.kept(most, LATER, cause, size)
    found = diagnose_sketch(bench.model, read_sums(past), [read_sums(later)], LINEAGE)
    assert found.verdict == cause
    (value,) = found.causes[0].parameters.values()
    assert value - (cause == "current_gain") == pytest.approx(size, rel=0.25)
    ((low, high),) = found.causes[0].ci95.values()
    assert low < value < high


def test_a_fleet_says_what_one_target_has(bench):
    """The sensor of one is late; the others are as the model."""
    kept = [bench.kept(1024, n) for n in (PAST, LATER, OWN, ("nn", "us06"), ("hwfta", "hwftb"))]
    units = {unit: [read_sums(block)] for unit, block in enumerate(kept)}
    units[9] = [read_sums(bench.kept(1024, LATER, "time_skew", 1.0))]
    found = diagnose_fleet(bench.model, units, LINEAGE)
    assert not found.common.causes
    assert {u for u, one in found.units.items() if one.causes} == {9}
    assert found.units[9].verdict == "time_skew"


def test_a_fleet_says_what_all_targets_have(bench):
    drives = (PAST, LATER, OWN, ("nn", "us06"), ("hwfta", "hwftb"))
    units = {
        unit: [read_sums(bench.kept(1024, names, "time_skew", 1.0))]
        for unit, names in enumerate(drives)
    }
    found = diagnose_fleet(bench.model, units, LINEAGE)
    assert found.common.verdict == "time_skew"
    assert not any(one.causes for one in found.units.values())


def test_a_thousand_targets_take_less_than_five_minutes(bench):
    import time

    one = read_sums(bench.kept(1024, LATER))
    rng = np.random.default_rng(4)
    units = {
        u: [one._replace(with_residual=one.with_residual * rng.normal(1.0, 0.1, 9))]
        for u in range(1000)
    }
    began = time.process_time()
    assert len(diagnose_fleet(bench.model, units).units) == 1000
    assert time.process_time() - began < 300.0


def test_without_a_past_nothing_is_named_and_it_says_why(bench):
    found = diagnose_sketch(bench.model, None, [read_sums(bench.kept(1024, PAST))])
    assert found.verdict == "undetermined"
    assert not found.causes
    assert "earlier sketch of the same target" in found.reasons[0]


def test_sketches_at_other_temperatures_do_not_compare(bench):
    """Where the model errs otherwise a cell that is the same would get a cause."""
    past = read_sums(bench.kept(1024, PAST))
    cold = past._replace(temperature_C=past.temperature_C - 35.0)
    found = diagnose_sketch(bench.model, past, [cold])
    assert (found.verdict, found.causes) == ("undetermined", ())
    assert "within 10 K" in found.reasons[0]


def test_sketches_of_other_tables_and_models_without_pictures_are_refused(bench):
    past = read_sums(bench.kept(1024, PAST))
    with pytest.raises(InputError, match="other tables"):
        diagnose_sketch(bench.model, past, [past._replace(model_crc=1)])
    with pytest.raises(InputError, match="make_pictures"):
        diagnose_sketch(stock_model(STOCK), past, [past])
    changed = replace(bench.model, capacity_Ah=2.5)
    with pytest.raises(InputError, match="not changed since"):
        pictures_in(changed)


def test_the_command_names_it_from_files(bench, tmp_path, capsys):
    model = tmp_path / "cell.json"
    write_model(bench.model, model)
    size = TIMES * usual(bench.model)["ohmic_resistance"]
    blocks = bench.kept(1024, PAST), bench.kept(1024, LATER, "ohmic_resistance", size)
    files = [tmp_path / "past.bin", tmp_path / "later.bin"]
    for file, block in zip(files, blocks, strict=True):
        file.write_bytes(block)
    asked = ["diagnose", "--model", str(model), "--sketch", *map(str, files)]
    assert main([*asked, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == found["causes"][0]["name"] == "ohmic_resistance"
    assert [one["unit"] for one in found["sketches"]] == [5, 5]
    assert main(asked) == 0
    assert "verdict: ohmic_resistance" in capsys.readouterr().out
    assert main([*asked, "--baseline", str(files[0])]) == 2
    assert "Give one or the other" in capsys.readouterr().err
