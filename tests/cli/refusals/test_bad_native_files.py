"""Bad native files of every format: one clear line, exit 2, nothing written."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from cellwise.data import datasets_folder
from log_files import pulse_channels
from tester_files import table, write_mat5, write_mat73, write_mpr, write_nda, write_ndax
from vehicle_files import (
    DBC,
    write_can,
    write_dataflash,
    write_dbc,
    write_mdf,
    write_mdf_frames,
    write_ulog,
)

for library in ("pyulog", "pymavlink", "asammdf", "cantools", "galvani", "fastnda", "h5py"):
    pytest.importorskip(library)

C = pulse_channels(600)
BDF = {"Test Time / s": C["time_s"], "Current / A": -C["current_A"], "Voltage / V": C["voltage_V"]}
GROUP = [(n, u, C["time_s"], C[n]) for n, u in (("current_A", "A"), ("voltage_V", "V"))]


def bdf_parquet(path):
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(BDF), path)
    return path


# Every binary format, a text one, and what makes a file of it.
WRITERS = {
    "ulog": lambda p: write_ulog(p, [C]),
    "dataflash": lambda p: write_dataflash(p, [C], "instances"),
    "mdf": lambda p: write_mdf(p, [GROUP]),
    "mdf frames": lambda p: write_mdf_frames(p, C),
    "blf": lambda p: write_can(p, C, "blf"),
    "asc": lambda p: write_can(p, C, "asc"),
    "nda": lambda p: write_nda(p, C),
    "ndax": lambda p: write_ndax(p, C),
    "mpr": lambda p: write_mpr(p, C),
    "mat 5": lambda p: write_mat5(p, C),
    "mat 7.3": lambda p: write_mat73(p, C),
    "bdf-parquet": bdf_parquet,
    "bdf-csv": lambda p: p.write_text(table(BDF)) and p,
}
CAN = ("blf", "asc", "mdf frames")
# What is left of these is a shorter file of the same kind, which says so where it can be known.
SHORTER = ("nda", "bdf-csv", "asc")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("native")
    made = {name: write(folder / name.replace(" ", "_")) for name, write in WRITERS.items()}
    return made, write_dbc(folder / "bms.dbc")


def commands(path, out, *options):
    return [
        ["inspect", str(path), *options],
        ["convert", str(path), "-o", str(out / "tidy.csv"), *options],
    ]


def only(folder, *names):
    return {p.name for p in folder.iterdir()} == set(names)


# An empty file and a cut near the end are quick tests.
DEEP_CUTS = [pytest.param(share, marks=pytest.mark.slow) for share in (0.001, 0.2, 0.6)]


@pytest.mark.parametrize("keep", [0.0, *DEEP_CUTS, 0.95])
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_was_cut_off(name, keep, files, refused, tmp_path):
    if name in SHORTER and keep > 0.1:
        pytest.skip("what is left is a log")
    made, dbc = files
    content = made[name].read_bytes()
    path = tmp_path / "log.bin"
    path.write_bytes(content[: int(keep * len(content))])
    options = ["--dbc", str(dbc)] if name in CAN and keep > 0.1 else []
    for command in commands(path, tmp_path, *options):
        message = refused(*command)
        assert "log.bin" in message
    assert only(tmp_path, "log.bin")


@pytest.mark.parametrize("name", ["ulog", "dataflash", "mdf", "mat 5", "bdf-parquet"])
def test_a_log_without_a_battery_lists_what_it_has(name, refused, tmp_path):
    path = tmp_path / "log.bin"
    if name == "ulog":
        write_ulog(path, [C], topic="vehicle_status")
        has = "vehicle_status"
    elif name == "dataflash":
        from vehicle_files import dataflash_format

        path.write_bytes(dataflash_format(130, "GPS", "Qf", "TimeUS,Spd"))
        has = "no battery message"
    elif name == "mdf":
        write_mdf(path, [[("EngineSpeed", "rpm", C["time_s"], C["current_A"])]])
        has = "EngineSpeed"
    elif name == "mat 5":
        from scipy.io import savemat

        savemat(path, {"weather": {"Wind": np.arange(5.0)}})
        has = "Wind"
    else:
        import pyarrow as pa
        from pyarrow import parquet

        parquet.write_table(pa.table({"wind": [1.0, 2.0]}), path)
        has = "wind"
    for command in commands(path, tmp_path):
        assert has in refused(*command)
    assert only(tmp_path, "log.bin")


@pytest.mark.parametrize("name", CAN)
@pytest.mark.parametrize(
    "database", ["", "no database", DBC.replace("256", "257").replace("512", "513")]
)
def test_a_can_log_with_another_database_is_refused(name, database, files, refused, tmp_path):
    dbc = write_dbc(tmp_path / "other.dbc", database)
    for command in commands(files[0][name], tmp_path, "--dbc", str(dbc)):
        refused(*command)
    assert only(tmp_path, "other.dbc")


def foreign(folder):
    """Files that are no logs."""
    folder.mkdir()
    (folder / "readme.md").write_text("# Notes\n\nNothing to see.\n")
    (folder / "empty.csv").write_bytes(b"")
    (folder / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(range(256)))
    (folder / "model.json").write_text('{"kind": "cellwise.CellModel"}')
    shutil.copy(datasets_folder() / "catalogue.toml", folder / "catalogue.toml")
    return folder


def test_a_folder_in_place_of_a_log(refused, model, tmp_path):
    place = str(foreign(tmp_path / "logs"))
    for command in commands(place, tmp_path):
        assert "a folder" in refused(*command)
    assert "a folder" in refused("replay", "--model", model, place)
    assert only(tmp_path, "logs")


@pytest.mark.parametrize("name", ["readme.md", "empty.csv", "photo.jpg", "model.json"])
def test_a_file_of_another_kind(name, refused, model, tmp_path):
    path = foreign(tmp_path / "logs") / name
    for command in commands(path, tmp_path):
        assert name in refused(*command)
    assert name in refused("replay", "--model", model, str(path), "-o", str(tmp_path / "o.csv"))
    assert only(tmp_path, "logs")


def test_a_fleet_of_other_files_alone(refused, model, tmp_path):
    place = foreign(tmp_path / "logs")
    message = refused("fleet", "replay", "--model", model, str(place), "-o", str(tmp_path / "out"))
    assert "none of the 5 files" in message
    assert only(tmp_path, "logs")
    none = ["--pattern", "*.ulg"]
    refused("fleet", "replay", "--model", model, str(place), "-o", str(tmp_path / "out"), *none)
    assert only(tmp_path, "logs")


def test_an_original_from_a_folder_of_other_files(refused, tmp_path):
    place = foreign(tmp_path / "logs")
    refused("data", "import", "lg_hg2", str(place), "-o", str(tmp_path / "out"))
    assert only(tmp_path, "logs")
