"""Originals from folders and archives: native files, names, a catalogue, what is left out."""

from __future__ import annotations

import shutil
import zipfile

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.data import list_datasets, load_dataset
from cellwise.datasets import import_dataset
from cellwise.datasets.importing import kind_of, temperature_of
from cellwise.errors import InputError
from cellwise.logs import read_log

ARBIN = (
    "Data_Point,Test_Time(s),Step_Index,Cycle_Index,Current(A),Voltage(V),Charge_Capacity(Ah),"
    "Discharge_Capacity(Ah)"
)


def arbin_rows(rows=300):
    t = np.arange(float(rows))
    return [
        (k + 1, 10 * t[k], 1, 1, -1.0 if k > 60 else 0.0, 4.1 - 1e-3 * k - 0.05 * (k > 60), 0.0,
         max(0.0, 10 * (k - 60) / 3600))
        for k in range(rows)
    ]  # fmt: skip


def write_arbin(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [ARBIN, *(",".join(repr(float(v)) for v in row) for row in arbin_rows())]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "download"
    write_arbin(place / "25degC" / "FUDS" / "cell_1.csv")
    write_arbin(place / "n10degC" / "549_C20DisCh.csv")
    (place / "25degC" / "broken.csv").write_text("x,y\n1,2\n")
    (place / "readme.txt").write_text("cite us")
    return place


def test_logs_are_written_and_named_with_a_catalogue(folder, tmp_path):
    out = tmp_path / "data"
    found = import_dataset("calce_a123", folder, out)
    assert [name for name, _ in found.left_out] == ["25degC/broken.csv"]
    entries = {e["source"]: e for e in list_datasets(out)}
    assert set(entries) == {"25degC/FUDS/cell_1.csv", "n10degC/549_C20DisCh.csv"}
    fuds, slow = entries["25degC/FUDS/cell_1.csv"], entries["n10degC/549_C20DisCh.csv"]
    assert (fuds["kind"], fuds["temperature_C"]) == ("drive", 25.0)
    assert (slow["kind"], slow["temperature_C"]) == ("ocv", -10.0)
    log = load_dataset(slow["name"], out)
    whole = read_log(folder / "n10degC" / "549_C20DisCh.csv")
    np.testing.assert_array_equal(log.current_A, whole.current_A)
    assert log.current_A.max() == 1.0  # discharge is positive now
    assert slow["rows"] == len(whole)


def test_an_archive_with_archives_within_is_the_same_as_its_folder(folder, tmp_path):
    inner = tmp_path / "n10degC.zip"
    with zipfile.ZipFile(inner, "w") as archive:
        archive.write(folder / "n10degC" / "549_C20DisCh.csv", "n10degC/549_C20DisCh.csv")
    outer = tmp_path / "all.zip"
    with zipfile.ZipFile(outer, "w") as archive:
        archive.write(inner, "n10degC.zip")
        archive.write(folder / "25degC" / "FUDS" / "cell_1.csv", "25degC/FUDS/cell_1.csv")
        archive.writestr("../escape.csv", "x,y\n1,2\n")
    found = import_dataset("calce_a123", outer, tmp_path / "data")
    sources = {e["source"] for e in found.entries}
    assert sources == {"n10degC.zip/n10degC/549_C20DisCh.csv", "25degC/FUDS/cell_1.csv"}
    assert not (tmp_path / "escape.csv").exists()


def test_a_workbook_of_arbin_is_the_same_as_its_csv(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    write_arbin(tmp_path / "cell.csv")
    book = openpyxl.Workbook()
    book.active.title = "Info"
    book.active.append(["Test name", "SP2_25C_FUDS"])
    rows = arbin_rows()
    for title, part in (("Channel_1-008_1", rows[:200]), ("Channel_1-008_2", rows[200:])):
        sheet = book.create_sheet(title)
        sheet.append(ARBIN.split(","))
        for row in part:
            sheet.append([float(v) for v in row])
    book.save(tmp_path / "cell.xlsx")
    excel, text = read_log(tmp_path / "cell.xlsx"), read_log(tmp_path / "cell.csv")
    assert excel.format == "arbin-excel"
    for name in ("time_s", "current_A", "voltage_V", "charge_Ah", "step"):
        np.testing.assert_allclose(getattr(excel, name), getattr(text, name), rtol=1e-12)


@pytest.mark.parametrize(
    ("native", "original", "kind"),
    [
        ("digatron_panasonic_c20_25degC.mat", "panasonic_18650pf", "ocv"),
        ("arbin_a123_ocv_p25_s1.csv", "plett_a123", "ocv"),
        ("bitrode_leaf_3c.csv", "nissan_leaf", "capacity"),
    ],
)
def test_originals_as_their_instrument_wrote_them(real_data, tmp_path, native, original, kind):
    place = tmp_path / "download"
    place.mkdir()
    shutil.copy(real_data / "native" / native, place / native)
    (entry,) = import_dataset(original, place, tmp_path / "data").entries
    assert entry["kind"] == kind
    log = load_dataset(entry["name"], tmp_path / "data")
    np.testing.assert_array_equal(log.voltage_V, read_log(place / native).voltage_V)


@pytest.mark.parametrize(
    ("path", "kind", "temperature"),
    [
        ("25degC/5 pulse disch/03-11-17_08.47 25degC_5Pulse_HPPC_Pan18650PF.mat", "hppc", 25.0),
        ("-10degC/Drive Cycles/06-10-17_11.25 n10degC_US06_Pan18650PF.mat", "drive", -10.0),
        ("25degC/C20 OCV and 1C discharge tests_start_of_tests/05-08-17_13.26 C20 OCV Test_C20_"
         "25dC.mat", "ocv", 25.0),
        ("n20degC/607_C20DisCh.csv", "ocv", -20.0),
        ("40degC/555_Charge3.csv", "charge", 40.0),
        ("25degC/551_UDDS.csv", "drive", 25.0),
        ("0degC/589_1C_Dis.csv", "capacity", 0.0),
        ("ocv_data/A123_OCV_P45_S1.csv", "ocv", 45.0),
        ("dyn_data/A123_DYN_50_N25_S1.csv", "drive", -25.0),
        ("SP2_0C_BJDST/11_06_2015_SP20-2_0C_BJDST_80SOC.xls", "drive", 0.0),
        ("something_else.csv", "other", None),
    ],
)  # fmt: skip
def test_names_as_people_write_them(path, kind, temperature):
    assert (kind_of(path), temperature_of(path)) == (kind, temperature)


def test_what_cannot_be_imported_is_refused_and_nothing_written(folder, tmp_path, capsys):
    out = tmp_path / "data"
    empty = tmp_path / "empty"
    empty.mkdir()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "photo.bin").write_bytes(b"\x00\x01\x02")
    for name, source in (
        ("unobtainium", folder),
        ("calce_a123", empty),
        ("calce_a123", tmp_path / "nowhere"),
        ("calce_a123", tmp_path / "foreign"),
        ("calce_a123", folder / "readme.txt"),
    ):
        with pytest.raises(InputError):
            import_dataset(name, source, out)
        assert not out.exists()
    out.mkdir()
    (out / "precious.txt").touch()
    with pytest.raises(InputError, match="holds something"):
        import_dataset("calce_a123", folder, out)
    assert main(["data", "import", "calce_a123", str(empty), "-o", str(tmp_path / "o")]) == 2
