"""Two examples of every command, and what it requires: the end of its help."""

from __future__ import annotations

# A command; what it requires; two commands as people type them.
TEXT = """\
start
  a folder with logs, native files among them
  start measurements
  start flights --run --nominal-ah 5.2
inspect
  a log; a text needs columns with units, native files need nothing
  inspect drive.csv
  inspect flight.bin --series 4
convert
  a log, and where to write it (.csv, .csv.gz or .parquet)
  convert cycler.mpt -o test.csv
  convert drive.csv --channel current_mA=I_pack -o drive.parquet
identify
  -o, and one test at least: pulses with an OCV test, or drives with --prior
  identify --hppc hppc.csv --ocv c20.csv --nominal-ah 2.9 -o cell.json
  identify --drive flight.bin --series 4 --prior lipo-pouch -o cell.json
simulate
  a model (a file or the name of a stock model) and a log with voltages
  simulate --model cell.json drive.csv
  simulate --model nmc-18650 --capacity-ah 3 drive.csv --soc0 1
replay
  a model and a log; where it stands at the start is found, or stated with --soc0
  replay --model cell.json drive.csv --report replay.html
  replay --model cell.json flight.bin --series 4 --estimator adaptive -o soc.csv
live
  a model and a source of samples
  live --model cell.json --source stdin < samples.csv
  live --model cell.json --source can:can0 --dbc pack.dbc --state soc.state
diagnose
  a model and a log; a second log of the same cell shows what the finding gains
  diagnose --model cell.json odd.csv --holdout other.csv -o extended.json
  diagnose --model cell.json odd.csv --baseline healthy.csv --report found.html
pack
  a model of the cell and logs with a voltage of every cell
  pack --model cell.json day1.csv day2.csv --report pack.html
  pack --model lmo-pouch --capacity-ah 65 day.parquet -o cells.csv
history
  a model and a cell's logs in the order of their age
  history --model cell.json 2023.csv 2024.csv 2025.csv --report life.html
  history --model cell.json year*.csv --save-model aged.json
export
  a model, the sample time of the target and a new folder
  export --model cell.json --dt 1 -o firmware
  export --model cell.json --dt 0.1 -o firmware --log drive.csv --report cost.html
certify
  a folder that `cellwise export` wrote, and a C compiler
  certify firmware -o certificate
  certify firmware --sensor sensor.toml --most-p95 0.05 --least-coverage 0.9
papers
  nothing
  papers
  papers --json
demo
  nothing
  demo
  demo -o pages
capacity-study
  nothing (embedded cells), or tests of a cell and a log to judge by
  capacity-study --cell embedded-nmc --report study.html
  capacity-study --hppc hppc.csv --ocv c20.csv --judge drive.csv --nominal-ah 2.9
benchmark
  nothing (the embedded suite), or the file or name of a suite
  benchmark --estimator ekf --estimator ukf -o results
  benchmark suite.toml --estimator mine.py:Mine -o results
fleet replay
  a model, a folder of logs and a place for the table
  fleet replay --model cell.json logs -o soc.parquet
  fleet replay --model cell.json logs -o soc.parquet --estimator adaptive --workers 8
fleet diagnose
  a model, a folder of logs and a place for the table
  fleet diagnose --model cell.json logs -o causes.parquet
  fleet diagnose --model cell.json logs -o causes.parquet --retry-failed
fleet pack
  a model, a folder with one folder of logs for each pack, a place for the table
  fleet pack --model cell.json packs -o cells.parquet
  fleet pack --model cell.json packs -o cells.parquet --workers 8
fleet history
  a model, a folder with one folder of logs for each cell, a place for the table
  fleet history --model cell.json cells -o ageing.parquet
  fleet history --model cell.json cells -o ageing.parquet --fresh
data list
  nothing
  data list
  data list --json
data fetch
  the name of a registered set, a folder and a network
  data fetch panasonic_18650pf -o originals
  data fetch nissan_leaf -o originals --json
data generate
  the extra 'generate' (PyBaMM) and a new folder
  data generate -o made
  data generate -o made --json
data import
  the name of a registered set and the folder of its originals
  data import panasonic_18650pf originals -o tidy
  data import nissan_leaf originals -o tidy --json
"""


def _guides() -> dict[str, tuple[str, ...]]:
    lines = TEXT.splitlines()
    return {lines[k]: tuple(map(str.strip, lines[k + 1 : k + 4])) for k in range(0, len(lines), 4)}


GUIDES = _guides()


def guide_of(program: str) -> str:
    """The end of a command's help; ``program`` is as argparse has it, "cellwise fleet replay".

    Empty for a command that only holds others.
    """
    name, _, command = program.partition(" ")
    if command not in GUIDES:
        return ""
    requires, first, second = GUIDES[command]
    return f"requires: {requires}\n\nexamples:\n  {name} {first}\n  {name} {second}"
