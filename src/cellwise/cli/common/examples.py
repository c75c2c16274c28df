"""Two examples of every command, and what it requires: the end of its help."""

from __future__ import annotations

from typing import NamedTuple


class Guide(NamedTuple):
    """What a command requires, and two commands as people type them."""

    requires: str
    first: str
    second: str

    def text(self) -> str:
        """The end of a help page."""
        return f"requires: {self.requires}\n\nexamples:\n  {self.first}\n  {self.second}"


GUIDES = {
    "start": Guide(
        "a folder with logs, native files among them",
        "start measurements",
        "start flights --run --nominal-ah 5.2",
    ),
    "inspect": Guide(
        "a log; a text needs columns with units, native files need nothing",
        "inspect drive.csv",
        "inspect flight.bin --series 4",
    ),
    "convert": Guide(
        "a log, and where to write it (.csv, .csv.gz or .parquet)",
        "convert cycler.mpt -o test.csv",
        "convert drive.csv --channel current_mA=I_pack -o drive.parquet",
    ),
    "identify": Guide(
        "-o, and one test at least: pulses with an OCV test, or drives with --prior",
        "identify --hppc hppc.csv --ocv c20.csv --nominal-ah 2.9 -o cell.json",
        "identify --drive flight.bin --series 4 --prior lipo-pouch -o cell.json",
    ),
    "simulate": Guide(
        "a model (a file or the name of a stock model) and a log with voltages",
        "simulate --model cell.json drive.csv",
        "simulate --model nmc-18650 --capacity-ah 3 drive.csv --soc0 1",
    ),
    "replay": Guide(
        "a model and a log; where it stands at the start is found, or stated with --soc0",
        "replay --model cell.json drive.csv --report replay.html",
        "replay --model cell.json flight.bin --series 4 --estimator adaptive -o soc.csv",
    ),
    "live": Guide(
        "a model and a source of samples",
        "live --model cell.json --source stdin < samples.csv",
        "live --model cell.json --source can:can0 --dbc pack.dbc --state soc.state",
    ),
    "diagnose": Guide(
        "a model and a log; a second log of the same cell shows what the finding gains",
        "diagnose --model cell.json odd.csv --holdout other.csv -o extended.json",
        "diagnose --model cell.json odd.csv --baseline healthy.csv --report found.html",
    ),
    "pack": Guide(
        "a model of the cell and logs with a voltage of every cell",
        "pack --model cell.json day1.csv day2.csv --report pack.html",
        "pack --model lmo-pouch --capacity-ah 65 day.parquet -o cells.csv",
    ),
    "history": Guide(
        "a model and a cell's logs in the order of their age",
        "history --model cell.json 2023.csv 2024.csv 2025.csv --report life.html",
        "history --model cell.json year*.csv --save-model aged.json",
    ),
    "export": Guide(
        "a model, the sample time of the target and a new folder",
        "export --model cell.json --dt 1 -o firmware",
        "export --model cell.json --dt 0.1 -o firmware --log drive.csv --report cost.html",
    ),
    "certify": Guide(
        "a folder that `cellwise export` wrote, and a C compiler",
        "certify firmware -o certificate",
        "certify firmware --sensor sensor.toml --most-p95 0.05 --least-coverage 0.9",
    ),
    "papers": Guide("nothing", "papers", "papers --json"),
    "demo": Guide("nothing", "demo", "demo -o pages"),
    "capacity-study": Guide(
        "nothing (embedded cells), or tests of a cell and a log to judge by",
        "capacity-study --cell embedded-nmc --report study.html",
        "capacity-study --hppc hppc.csv --ocv c20.csv --judge drive.csv --nominal-ah 2.9",
    ),
    "benchmark": Guide(
        "nothing (the embedded suite), or the file or name of a suite",
        "benchmark --estimator ekf --estimator ukf -o results",
        "benchmark suite.toml --estimator mine.py:Mine -o results",
    ),
    "fleet replay": Guide(
        "a model, a folder of logs and a place for the table",
        "fleet replay --model cell.json logs -o soc.parquet",
        "fleet replay --model cell.json logs -o soc.parquet --estimator adaptive --workers 8",
    ),
    "fleet diagnose": Guide(
        "a model, a folder of logs and a place for the table",
        "fleet diagnose --model cell.json logs -o causes.parquet",
        "fleet diagnose --model cell.json logs -o causes.parquet --retry-failed",
    ),
    "fleet pack": Guide(
        "a model, a folder with one folder of logs for each pack, a place for the table",
        "fleet pack --model cell.json packs -o cells.parquet",
        "fleet pack --model cell.json packs -o cells.parquet --workers 8",
    ),
    "fleet history": Guide(
        "a model, a folder with one folder of logs for each cell, a place for the table",
        "fleet history --model cell.json cells -o ageing.parquet",
        "fleet history --model cell.json cells -o ageing.parquet --fresh",
    ),
    "data list": Guide("nothing", "data list", "data list --json"),
    "data fetch": Guide(
        "the name of a registered set, a folder and a network",
        "data fetch panasonic_18650pf -o originals",
        "data fetch nissan_leaf -o originals --json",
    ),
    "data generate": Guide(
        "the extra 'generate' (PyBaMM) and a new folder",
        "data generate -o made",
        "data generate -o made --json",
    ),
    "data import": Guide(
        "the name of a registered set and the folder of its originals",
        "data import panasonic_18650pf originals -o tidy",
        "data import nissan_leaf originals -o tidy --json",
    ),
}


def guide_of(program: str) -> str:
    """The end of a command's help; ``program`` is as argparse has it, "cellwise fleet replay".

    Empty for a command that only holds others.
    """
    name, _, command = program.partition(" ")
    if command not in GUIDES:
        return ""
    guide = GUIDES[command]
    return Guide(guide.requires, *(f"{name} {one}" for one in guide[1:])).text()
