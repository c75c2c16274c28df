"""One theorem over all commands: what an option cannot be is one message, exit 2, nothing written.

A block is a command; below it a line for each refusal: options, and a part of the message.
"""

from __future__ import annotations

import argparse
import shlex

import pytest

from cellwise.cli import main
from cellwise.cli.command_line import build_parser
from cellwise.data import datasets_folder

HPPC = str(datasets_folder() / "nmc" / "hppc.parquet")
REFUSED = """
|
  | no COMMAND; expected one of start, demo, inspect
  conjure | 'conjure'; expected one of start
  identfy | Did you mean 'identify'?
  inspect | Add it: cellwise inspect nmc_drive_a
  convert a.csv | Add it: cellwise convert a.csv -o test.csv
  replay --pwoer | Did you mean '--power'?
  identify --bogus | unrecognized arguments: --bogus
  identify a.csv --nominal-ah 3 | unrecognized arguments: a.csv
  replay cell.json | Add it: cellwise replay nmc_drive_a --model cell.json
  replay cell.json a.csv --power | Add it: cellwise replay a.csv --power --model cell.json
  export cell.json | Add it: cellwise export --dt 1 -o firmware --model cell.json
  data | no ACTION; expected one of fetch
  data steal | 'steal'; expected one of fetch
  inspect a.csv --sign upside-down | 'upside-down'; expected --sign auto|charge-positive
  inspect a.csv --s auto | --s could match --sign, --series
  pack --model nmc-18650 | no PACKLOG; expected PACKLOG: one pack
inspect DRIVE
  --series four | --series four
  --series 0 | series = 0
  --parallel 2.5 | --parallel
  --instance first | --instance
  --channel current_A | NAME=COLUMN
  --channel current_A=Strom | no column 'Strom'
simulate --model MODEL DRIVE
  --soc0=-0.01 | 0 to 1
  --soc0=1.01 | 0 to 1
  --soc0=100 | 0 to 1
  --soc0=nan | 0 to 1
  --soc0=inf | 0 to 1
  --soc0=half | 0 to 1
  --soc0= | 0 to 1
simulate --model nmc-21700 DRIVE
  | lipo-pouch
replay --model nmc-21700 DRIVE
  | lipo-pouch
diagnose --model nmc-21700 DRIVE
  | lipo-pouch
replay --model nmc-18650 DRIVE
  --capacity-ah=0 | above zero
  --capacity-ah=-1 | above zero
  --capacity-ah=nan | above zero
replay --model MODEL DRIVE
  --soc0=1.01 | 0 to 1
  --estimator oracle | coulomb, ekf, ukf, adaptive
  --estimater ekf | Did you mean '--estimator'?
  --dt 0 | step
  --dt -1 | step
  --dt nan | step
  --dt 1e9 | step
  --dt 1e-9 | step
  --dt soon | --dt S: a number
  --soc0-std -0.1 | 0.1
  --reference-capacity-ah 0 | reference capacity
  --reference-capacity-ah nan | reference capacity
  --reference-soc0 1.5 --reference-capacity-ah 5 | --reference-soc0
  --cutoff-v 14 | not of the pack
  --report out.pdf | --figure-format pdf
  -o rows.xlsx | rows.xlsx
  -o XXX.csv | XXX
replay --model nmc-18650 --capacity-ah 5 DRIVE
  POWER
live --model nmc-18650 --capacity-ah 5 --source json:STREAM
  POWER
live --model MODEL
  --source telepathy | telepathy
  --source stdin --estimator coulomb | coulomb
  --source stdin --soc0 80 | 80
  --source stdin --send A.B | A.B
  --source stdin --every -1 | --every -1
  --source can:virtual:x | dbc
  --source json:nowhere | nowhere
  --source stdin --series auto | auto
  --source stdin --state nowhere/state.json | nowhere
  --source stdin -o nowhere/out.jsonl | nowhere
  --source stdin --cutoff-v 12 | 12
identify -o m.json
  | --hppc LOG or --drive LOG
  --hppc HPPC --nominal-ah -5 | nominal
  --hppc HPPC --nominal-ah 0.005 | nominal
  --hppc HPPC --capacity-choice 'all of it' | hppc-total
  --hppc HPPC --capacity-choice rate:C/0 | rate
  --hppc HPPC --temperature-c 298 | 298 degC
  --hppc HPPC@warm | LOG@TEMPERATURE
  --hppc nowhere.csv | nowhere.csv
  --hppc HPPC --method guess | --method
  --hppc HPPC --branches 7 | --branches
  --drive HPPC --no-refine --nominal-ah 5 | --no-refine
  --drive DRIVE --nominal-ah 5 --prior nickel | nca-18650
diagnose --model MODEL DRIVE -o new.json
  --holdout no.csv | no.csv
  --baseline no.csv | no.csv
  --soc0 1.2 | 1.2
  --soc0 full | full
  --report nowhere/p.html | nowhere
  --corrected HPPC | hppc
  --holdout DRIVE | drive
  --cause gremlins | gremlins
diagnose --model missing.json DRIVE
  | missing.json
diagnose --model MODEL
  | Add it: cellwise diagnose nmc_drive_a --model MODEL
fleet replay --model MODEL LOGS -o out
  --estimator oracle | oracle
  --soc0 80 | 80
  --workers 0 | workers 0
  --pattern *.xyz | *.xyz
  --series x | --series x
fleet diagnose --model MODEL LOGS -o out
  --cause gremlins | gremlins
demo
  -o FILE | FILE
benchmark
  nothing.toml | no suite
  panasonic | CELLWISE_DATA
  embedded --processes 0 | --processes 0
  embedded --data nowhere | no folder
  embedded --estimator kalman | estimator 'kalman'
  embedded --estimator mine.py:Filter | no file 'mine.py'
"""
PAGES = ("replay --model m.json log.csv", "identify --hppc log.csv -o m.json",
         "diagnose --model m.json log.csv", "export --model m.json --dt 1 -o out",
         "capacity-study", "benchmark", "demo")  # fmt: skip
PAGE = "  --figure-format svg | --figures\n  --figures FILE | a file at"
POWER = """\
  --horizons 10 | Add --power
  --voltage-limits 2.8 4.2 | Add --power
  --power --horizons ten | separated by commas
  --power --horizons 0 | times above zero
  --power --horizons 10,-2 | times above zero
  --power --voltage-limits 4.2 2.8 | lower one below the upper one
  --power --current-limits 5 -5 | without a sign
  --power --soc-limits 10 90 | Divide by 100
  --power --voltage-limits 9 12 | not of the pack"""


def commands(parser):
    """Every command and every action of one, the program first."""
    yield parser
    for part in parser._actions:
        if isinstance(part, argparse._SubParsersAction):
            for inner in part.choices.values():
                yield from commands(inner)


def cases():
    """Command line and a part of its message."""
    text = REFUSED.replace("  POWER", POWER) + "\n".join(f"{page}\n{PAGE}" for page in PAGES)
    command = ""
    for line in text.strip().splitlines():
        if line.startswith("  "):
            options, _, says = line.strip().partition("| ")
            yield f"{command} {options}".strip(), says
        else:
            command = line.strip("|")


@pytest.mark.parametrize(("line", "says"), list(cases()))
def test_a_wrong_option_is_refused_with_what_to_do(
    line, says, model, drive, refused, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CELLWISE_DATA", raising=False)
    inputs = tmp_path.with_name(f"{tmp_path.name}_inputs")
    inputs.mkdir()
    (inputs / "stream.jsonl").write_text('{"time_s": 0, "current_A": 1, "voltage_V": 3.7}\n')
    given = {
        "MODEL": model,
        "DRIVE": drive,
        "HPPC": HPPC,
        "LOGS": str(datasets_folder() / "nmc"),
        "STREAM": str(inputs / "stream.jsonl"),
        "FILE": str(inputs / "stream.jsonl"),
        "XXX": "x" * 300,
    }
    for name, value in given.items():
        line = line.replace(name, value)
        says = says.replace(name, value[:20])
    assert says in refused(*shlex.split(line))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("line", ["inspect", "simulate", "replay DRIVE", "convert"])
def test_the_line_that_a_refusal_proposes_runs_as_it_is_pasted(
    line, drive, refused, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    said = refused(*line.replace("DRIVE", drive).split())
    proposed = shlex.split(said.rpartition("Add it: ")[2])
    assert proposed[0] == "cellwise"
    assert main(proposed[1:]) == 0


@pytest.mark.parametrize("parser", [pytest.param(p, id=p.prog) for p in commands(build_parser())])
def test_every_command_without_what_it_requires_says_so_in_the_house_s_words(parser, refused):
    needed = [action for action in parser._actions if action.required]
    if needed:
        said = refused(*parser.prog.split()[1:])
        assert said.startswith(f"{parser.prog}: found no ")
        assert all((a.option_strings or [a.metavar])[0] in said for a in needed)
        assert f"Add it: {parser.prog} " in said or said.endswith(f"See {parser.prog} --help")
    assert {a.required for a in needed} <= {True}  # the help still marks it
