"""Causes from the bytes of sketches alone, hidden in two weeks of measured drives."""

from __future__ import annotations

import json
import shutil
import zlib
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.equations import look_up
from cellwise.cell.model_file import write_model
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.diagnose.sketch_pictures import NAMED, pictures_in, usual
from cellwise.diagnose.sketched import diagnose_fleet, diagnose_sketch
from cellwise.errors import InputError
from cellwise.estimate.sketch.stored import read_sums
from cellwise.export.patch import BLOCK, RESISTANCE_KNOTS, taken
from measured_models import LATER, LINEAGE, OWN, PAST, STOCK, SketchBench

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
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


@pytest.fixture(scope="module")
def bench(real_data):
    return SketchBench(real_data / "panasonic_18650pf")


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


@pytest.mark.parametrize(("most", "cause"), [*missed_marks()])
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


@pytest.fixture(scope="module")
def field(bench, tmp_path_factory):
    """The model and its export as targets have it, and what one kept while its cell was good."""
    place = tmp_path_factory.mktemp("field")
    write_model(bench.model, place / "cell.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.export.cross.cores_here", list)
        export = ["export", "--model", str(place / "cell.json"), "--dt", "1", "--health"]
        assert main([*export, "--sketch", "1024", "-o", str(place / "firmware")]) == 0
    for unit in (5, 9):
        block = bench.kept(1024, PAST, unit=unit, health=True)
        (place / f"good_{unit}.bin").write_bytes(block)
    return place


def patched(field, capsys, *files, more=()):
    """Exit code, JSON and error of `diagnose --sketch --patch`."""
    asked = ["diagnose", "--model", field / "cell.json", "--sketch", *files, "--json"]
    asked += ["--patch", field / "a.patch", "--export", field / "firmware", "--generation", "3"]
    capsys.readouterr()
    code = main([*map(str, (*asked, *more))])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else None, err


def test_what_a_sketch_names_is_written_as_a_patch(bench, field, tmp_path, capsys):
    """Its factor is what the hidden ohms are of the drop of a long load, at every SOC."""
    ohm = TIMES * usual(bench.model)["ohmic_resistance"]
    later = tmp_path / "later.bin"
    later.write_bytes(bench.kept(1024, LATER, "ohmic_resistance", ohm, health=True))
    code, found, err = patched(field, capsys, field / "good_5.bin", later)
    assert code == 0, err
    assert found["patch"] == found["cells"][0]["patch"] == str(field / "a.patch")
    block = (field / "a.patch").read_bytes()
    assert len(block) == BLOCK.itemsize <= 128
    # A sketch says of which tables it is: without the export the same.
    asked = ["diagnose", "--model", field / "cell.json", "--sketch", field / "good_5.bin", later]
    asked += ["-o", tmp_path / "b.patch", "--generation", "3"]
    assert main([*map(str, asked)]) == 0
    assert (tmp_path / "b.patch").read_bytes() == block
    took = taken(block, bench.target(1024, True).stepper(1.0).tables)[0]
    assert took["generation"] == 3
    assert (took["offset_A"], took["per_gain"], took["per_capacity"]) == (0.0, 1.0, 1.0)
    assert not np.any(took["shift_V"])
    (added_ohm,) = found["causes"][0]["parameters"].values()
    assert added_ohm == pytest.approx(ohm, rel=0.25)
    parameters = bench.model.parameters()
    for k, soc in enumerate(np.linspace(0.0, 1.0, RESISTANCE_KNOTS)):
        p = look_up(parameters, soc, found["sketches"][1]["temperature_C"])
        drop_ohm = p.r0_ohm + p.r1_ohm + p.r2_ohm + p.r3_ohm
        assert took["resistance"][:, k] == pytest.approx(1.0 + added_ohm / drop_ohm, rel=0.05)


def test_where_a_sketch_names_nothing_or_no_patch_holds_it_none_is_written(
    bench, field, tmp_path, capsys
):
    late_s = TIMES * usual(bench.model)["time_skew"]
    for name, more, said in (
        ("same.bin", (), "no cause"),
        ("late.bin", ("time_skew", late_s), "time_skew"),
    ):
        later, place = tmp_path / name, field / "a.patch"
        place.unlink(missing_ok=True)
        later.write_bytes(bench.kept(1024, LATER, *more, health=True))
        code, found, err = patched(field, capsys, field / "good_5.bin", later)
        assert code == 0, err
        assert (found["patch"], found["no_patch"]) == (None, said)
        assert not place.exists()


def test_every_target_of_a_fleet_gets_its_own_patch(bench, field, tmp_path, capsys):
    """One has more ohms, the other is as it was."""
    ohm = TIMES * usual(bench.model)["ohmic_resistance"]
    files = [field / "good_5.bin", field / "good_9.bin", tmp_path / "5.bin", tmp_path / "9.bin"]
    files[2].write_bytes(bench.kept(1024, LATER, health=True))
    files[3].write_bytes(bench.kept(1024, LATER, "ohmic_resistance", ohm, unit=9, health=True))
    code, found, err = patched(field, capsys, *files)
    assert code == 0, err
    cells = {one["unit"]: one for one in found["cells"]}
    assert (cells[5]["patch"], cells[5]["no_patch"]) == (None, "no cause")
    assert cells[9]["patch"] == str(field / "a_9.patch")
    assert (field / "a_9.patch").is_file()
    assert not (field / "a_5.patch").exists()
    assert "patch" not in found


def test_a_patch_of_sketches_of_another_export_is_refused(bench, field, tmp_path, capsys):
    """Their tables are others: such a target would refuse the patch."""
    files = tmp_path / "good.bin", tmp_path / "later.bin"
    for file, names in zip(files, (PAST, LATER), strict=True):
        block = bytearray(bench.kept(1024, names))
        block[4:8] = b"else"  # in place of the CRC of its tables
        block[-4:] = zlib.crc32(block[:-4]).to_bytes(4, "little")
        file.write_bytes(block)
    code, _, err = patched(field, capsys, *files)
    assert code == 2
    assert "of other tables than the export's" in err
