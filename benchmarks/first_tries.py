"""Forty first tries: files as published, the options that the documentation names first.

    python -m benchmarks.first_tries [--only TEXT]

Each try gives a model, or a refusal that names what was found and what to do. A refusal counts
where the table says why nobody could use the files; beside a model stands its error on its logs.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.measured_data import HOW, data_folder
from cellwise.cli import main as cellwise
from cellwise.logs import read_log, write_log

ASKED = 38  # of 40


class Try(NamedTuple):
    """Options of `identify`, a part of a file as ``name[0.3:0.6]``; why nobody could use it."""

    cell: str
    options: str
    no_use: str = ""


PRIOR = {
    "panasonic_18650pf": "--prior nca-18650 --nominal-ah 2.9",
    "lg_18650hg2": "--prior nmc-18650 --nominal-ah 3",
    "plett_a123": "--prior lfp-26650 --nominal-ah 2.3",
    "leaf_pack": "--prior lmo-pouch --nominal-ah 65",
    "lipo_5450": "--prior lipo-pouch --nominal-ah 5.45",
}
TRIES = (
    Try("panasonic_18650pf", "--hppc hppc_p25.csv.gz --ocv ocv_c20_p25.csv.gz --nominal-ah 2.9"),
    Try("panasonic_18650pf", "--capacity cap_1c_p25_start_1.csv.gz --nominal-ah 2.9"),
    Try("panasonic_18650pf", "--ocv ocv_c20_p25.csv.gz"),
    Try("panasonic_18650pf", "--drive drive_p25_us06.csv.gz --nominal-ah 2.9"),
    Try("panasonic_18650pf", "--drive drive_n20_udds.csv.gz PRIOR"),
    Try("panasonic_18650pf", "--drive drive_p00_us06.csv.gz --drive drive_p10_us06.csv.gz PRIOR"),
    Try("panasonic_18650pf", "--drive drive_p25_nn.csv.gz[0.3:0.6] PRIOR"),
    Try("panasonic_18650pf", "--drive charge1_1c_p25_start.csv.gz PRIOR"),
    Try("panasonic_18650pf", "--hppc hppc_p25.csv.gz[0.4:0.7] --nominal-ah 2.9"),
    Try("lg_18650hg2", "--ocv ocv_c20_p25_549.csv.gz --nominal-ah 3"),
    Try("lg_18650hg2", "--ocv ocv_c20_p25_549.csv.gz --capacity cap_2c_p25_549.csv.gz"),
    Try("lg_18650hg2", "--capacity cap_?c_p25_*.csv.gz --nominal-ah 3"),
    Try("lg_18650hg2", "--drive pauscycl_*.csv.gz PRIOR"),
    Try("lg_18650hg2", "--capacity cap_1c_p25_551.csv.gz --drive drive_us06_n10_601.csv.gz"),
    Try("lg_18650hg2", "--drive drive_us06_n10_601.csv.gz[0.5:0.9] PRIOR"),
    Try("lg_18650hg2", "--drive drive_mixed8_p40_562.csv.gz PRIOR"),
    Try("plett_a123", "--ocv ocv_p25_s1.csv.gz@25 --nominal-ah 2.3"),
    Try("plett_a123", "--ocv ocv_p25_s2.csv.gz@25 --nominal-ah 2.3"),
    Try("plett_a123", "--drive dyn_p25_s1.csv.gz@25 PRIOR"),
    Try("plett_a123", "--drive dyn_p35_s1.csv.gz@35[0.2:0.5] PRIOR"),
    Try("plett_a123", "--ocv ocv_n15_s3.csv.gz@-15 --drive dyn_n15_s3.csv.gz@25 --nominal-ah 2.3"),
    Try("nissan_leaf", "--hppc hppc_p25.csv.gz@25 --nominal-ah 33"),
    Try("nissan_leaf", "--hppc hppc_p10.csv.gz@10[0:0.5] --nominal-ah 33"),
    Try("nissan_leaf", "--capacity cap_3c_p23.csv.gz"),
    Try("nissan_leaf", "--ocv cycling_c15_10c_24c_40c.csv.gz --nominal-ah 33"),
    Try("nissan_leaf", "--drive modules_cc_1c.csv.gz --prior lmo-pouch --nominal-ah 65"),
    Try("leaf_pack", "--drive leaf_20170522.parquet PRIOR"),
    Try("leaf_pack", "--drive leaf_2017060*.parquet PRIOR"),
    Try("leaf_pack", "--drive leaf_20170523.parquet --nominal-ah 65"),
    Try("leaf_pack", "--drive leaf_20170422.parquet PRIOR", "five minutes at rest, 1 A at most"),
    Try("samsung_30q_ageing", "--capacity d1_cellA_cycle001.csv.gz --nominal-ah 3"),
    Try("samsung_30q_ageing", "--capacity d1_cellA_cycle?01.csv.gz --nominal-ah 3"),
    Try("samsung_30q_ageing", "--hppc hppc_dnn01_1c_p20_time_rebuilt.csv.gz@20 --nominal-ah 3"),
    Try("samsung_30q_ageing", "--drive fresh_s001_discharge_3c.csv.gz[0.2:0.8] --nominal-ah 3"),
    Try("lipo_5450", "--capacity c1_cycle01.csv.gz --capacity c2_cycle01.csv.gz"),
    Try("lipo_5450", "--drive c3_cycle01.csv.gz[0.1:0.4] PRIOR"),
    Try("native", "--drive ardupilot_dronekit-la_log171.bin --series 4 --prior lipo-pouch "
        "--nominal-ah 5"),
    Try("native", "--drive px4_pyulog_sample_log_small.ulg --series auto --prior lipo-pouch "
        "--nominal-ah 5", "six seconds on a bench, 0.01 % of the capacity"),
    Try("native", "--ocv digatron_panasonic_c20_25degC.mat --nominal-ah 2.9"),
    Try("native", "--capacity bitrode_leaf_3c.csv --nominal-ah 33"),
)  # fmt: skip


def arguments_of(one: Try, data: Path, folder: Path) -> list[str]:
    """The options with whole paths; parts of logs are written first."""
    found = ["identify"]
    for word in one.options.replace("PRIOR", PRIOR.get(one.cell, "")).split():
        name, cut, part = word.partition("[")
        if "." not in name or name[0].isdigit() or name.startswith("--"):
            found.append(word)
            continue
        path, at, stated = name.partition("@")
        place = data / one.cell / path
        if cut:
            log = read_log(place)
            first, last = (int(float(x) * len(log)) for x in part.rstrip("]").split(":"))
            place = write_log(log.part(first, last), folder / f"part_of_{path.split('.')[0]}.csv")
        found.append(f"{place}{at}{stated}")
    return [*found, "-o", str(folder / "model.json"), "--json"]


def outcome(one: Try, data: Path) -> tuple[bool, str]:
    """Whether a try is a good first try, and what came of it."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = arguments_of(one, data, Path(folder))
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cellwise(arguments)
    if code == 0:
        found = json.loads(out.getvalue())
        by = found["posterior"]["prior"] if found["posterior"] else "its pulses"
        said = "" if one.no_use == "" else " (a model of nothing)"
        return not one.no_use, f"model by {by}, {1e3 * found['fit']['rmse_V']:.1f} mV{said}"
    return bool(one.no_use) and code == 2, err.getvalue().strip().splitlines()[-1]


def main(arguments: list[str] | None = None) -> int:
    """Try all and print a line each; 1 where fewer are good than asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="tries whose cell or options hold this text")
    chosen = parser.parse_args(arguments)
    data = data_folder()
    if data is None:
        raise SystemExit(f"no measured cells: {HOW}")
    tries = [t for t in TRIES if chosen.only in f"{t.cell} {t.options}"]
    good = 0
    for one in tries:
        began = time.perf_counter()
        fine, said = outcome(one, data)
        good += fine
        mark = "ok " if fine else "BAD"
        print(f"{mark} {one.cell}: {one.options}", flush=True)
        print(f"      {said} ({time.perf_counter() - began:.0f} s)", flush=True)
    print(f"{good} of {len(tries)} give a model or a justified refusal (asked {ASKED} of 40)")
    return int(good < ASKED * len(tries) / len(TRIES))


if __name__ == "__main__":
    sys.exit(main())
