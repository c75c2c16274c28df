"""Parsers of the commands, from what their modules say of themselves.

The docstring of a module of `cellwise.cli` is the interface of its commands. It is read without the
module's import: help must not wait for compilers. A command that it names is there, and
`run_` with the last word of its name is what it does::

    cellwise NAME: what it does
        requires what it cannot do without
        $ NAME an example, as it is typed
        LOG                         an argument; LOG+ several, LOG* or none, [LOG=x] one that may
                                    be left out
        -o, --output OUT!           an option that is required
        --estimator E=ekf           one with a default
        --hold power|current=power  one with choices
        --cause C...                one that may be given several times
        --plan P+                   one with several values at a time
        --limits LOW HIGH           one with two numbers
        --display [X=0.1]           one whose value may be left out
        --anyway                    one that is there or not
        <page>                      those of that name in `SHARED`
        packs and native logs:      begins a group of the help

A metavar states the type: N is a whole number; A, H, MS, S, V, W, X are numbers; the rest is text.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# The commands in the order of work, as the help lists them.
WORK = {
    "begin": ("start", "demo", "inspect", "convert", "data"),
    "model": ("identify", "simulate", "replay", "diagnose", "capacity-study"),
    "in use": ("history", "pack", "live", "fleet"),
    "compare": ("benchmark", "papers"),
    "target": ("export", "certify"),
}
ORDER = tuple(name for names in WORK.values() for name in names)

SECTION = re.compile(r"^cellwise ([a-z -]+): (.*)$", re.MULTILINE)
SET = re.compile(r"^<([a-z -]+)>$", re.MULTILINE)
CONTINUED = re.compile(r"\n {5,}")  # deeper than what an item stands at
NUMBERS = ("A", "H", "MS", "S", "V", "W", "X")

Commands = argparse._SubParsersAction  # made by `add_subparsers`


def sections() -> dict[str, tuple[str, str, str]]:
    """Module, meaning and items of every command, by its name."""
    found = {}
    for path in Path(__file__).parents[1].glob("*.py"):
        _, docstring, *_ = path.read_text(encoding="utf-8").split('"""', 2)
        parts = SECTION.split(docstring)[1:]
        for name, about, items in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
            found[name] = path.stem, about, items
    return dict(sorted(found.items(), key=_place))


def _place(section: tuple[str, tuple[str, str, str]]) -> tuple[int, str]:
    """By the order of work; an action behind its command."""
    return ORDER.index(section[0].partition(" ")[0]), section[0]


def listed_commands() -> str:
    """The commands with what they do, grouped in the order of work."""
    about = {name: said for name, (_, said, _) in sections().items()}
    lines = [
        f"{group if name == names[0] else '':<9}{name:<15}{about[name]}"
        for group, names in WORK.items()
        for name in names
    ]
    return "\n".join(lines)


def add_commands(parser: argparse.ArgumentParser) -> None:
    """Add every command, those of one word first."""
    listed = argparse.SUPPRESS  # the description lists them
    commands = {
        "": parser.add_subparsers(
            dest="command", metavar="COMMAND", required=True, help=listed, prog=parser.prog
        )
    }
    for name, (module, about, items) in sections().items():
        outer, _, action = name.rpartition(" ")
        one = commands[outer].add_parser(
            action,
            help=about,
            description=f"{about[:1].upper()}{about[1:]}.",
            epilog=_guide(items) if items.strip() else None,
            examples=_examples(items),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        # An action's own default would hide what stands before it.
        quiet = argparse.SUPPRESS if outer else False
        text = "show the traceback of an error"
        one.add_argument("--debug", action="store_true", default=quiet, help=text)
        if not items.strip():
            commands[name] = one.add_subparsers(dest="action", metavar="ACTION", required=True)
            continue
        _add_items(one, items)
        text = "print one JSON object and no more"
        one.add_argument("--json", action="store_true", help=text)
        call = module, f"run_{action.replace('-', '_')}"
        one.set_defaults(call=call)


def _guide(items: str) -> str:
    """The end of a command's help."""
    said = [line.strip() for line in items.splitlines()]
    needs = "".join(f"requires: {s[9:]}\n\n" for s in said if s.startswith("requires "))
    return needs + "\n".join(["examples:", *(f"  {one}" for one in _examples(items))])


def _examples(items: str) -> tuple[str, ...]:
    """The lines that a command's help shows."""
    said = (line.strip() for line in items.splitlines())
    return tuple(f"cellwise{line[1:]}" for line in said if line[:1] == "$")


def _lines(items: str) -> Iterator[str]:
    """Items with what they continue on, those of sets in their place."""
    parts = SET.split(SHARED)[1:]
    shared = dict(zip(parts[::2], parts[1::2], strict=True))
    for line in map(str.strip, CONTINUED.sub(" ", items).splitlines()):
        if found := SET.match(line):
            yield from _lines(shared[found[1]])
        elif line and not line.startswith(("$ ", "requires ")):
            yield line


def _add_items(parser: argparse.ArgumentParser, items: str) -> None:
    place: argparse._ActionsContainer = parser
    for line in _lines(items):
        if line.endswith(":") and "  " not in line:
            place = parser.add_argument_group(line[:-1])
        else:
            words, _, text = line.partition("  ")
            _add_item(place, words.replace(", ", " ").split(), text.strip().replace("%", "%%"))


def _add_item(place: argparse._ActionsContainer, words: list[str], text: str) -> None:
    """One argument or option; the marks of its value are those of the module's docstring."""
    names = [word for word in words if word.startswith("-")]
    values = words[len(names) :]
    if not values:
        place.add_argument(*names, action="store_true", help=text)
    elif len(values) > 1:
        metavar = tuple(values)
        place.add_argument(*names, nargs=len(values), type=float, metavar=metavar, help=text)
    else:
        _add_valued(place, names, values[0], text)


def _add_valued(place: argparse._ActionsContainer, names: list[str], value: str, text: str) -> None:
    more: dict[str, Any] = {}
    default = None
    if value.endswith("..."):
        value, more = value[:-3], {"action": "append", "default": []}
    elif value.endswith("+"):
        value, more = value[:-1], {"nargs": "+"}
        more |= {"action": "extend", "default": []} if names else {}
    elif value.endswith("*") and "=" not in value:
        value, more = value[:-1], {"nargs": "*", "default": []}
    else:
        optional = value.startswith("[")
        required, value = value.endswith("!"), value.strip("[]!")
        value, _, default = value.partition("=")
        more = {"nargs": "?"} if optional else {}
        more |= {"required": True} if required else {}
    kind: type[float] | type[int] | type[str] = (
        int if value == "N" or value.replace("|", "").isdigit() else str
    )
    kind = float if value in NUMBERS else kind
    if default:
        more["const" if names and "nargs" in more else "default"] = kind(default)
        text += f" [{default}]"
    if "|" in value:
        more["choices"] = [kind(one) for one in value.split("|")]
    else:
        more["metavar"] = value
    dest = [] if names else [value.lower() + ("s" if more.get("nargs") in ("+", "*") else "")]
    place.add_argument(*names, *dest, type=kind, help=text.strip(), **more)


# Options that several commands share.
SHARED = """
<model>
    --model MODEL!  model file, or a stock model (`cellwise data list`)
<scaled model>
    <model>
    --capacity-ah X  scale the model to this capacity: resistances by the inverse ratio [its own]
<log>
    LOG  a table of text or parquet, or a native file; @-20 or @temperature_C=-20,soc0=1 behind it
        says what is known of it; or an embedded data set's name
<log options>
    --sign auto|charge-positive|discharge-positive=auto  sign of the current in the file
    packs and native logs:
    --series COUNT=1  cells in series, to read a pack as its mean cell; auto: as the log states
    <channels>
    --dbc FILE  database of the frames of a CAN log
    --partial  read a recording that was cut off, as far as it goes
    --decimal auto|.|,=auto  decimal sign of a text, by its first rows
<stream options>
    --sign auto|charge-positive|discharge-positive=auto  sign of the current in the stream
    packs and native logs:
    --series COUNT=1  cells in series, to read a pack as its mean cell
    <channels>
    --dbc FILE  database of the frames of a CAN bus
<channels>
    --parallel N=1  cells in parallel
    --channel NAME=COLUMN...  which column or signal is which, e.g. current_mA=I_pack; NAME gives
        the unit
    --instance N  which battery of several, from 0
<cells options>
    --sign auto|charge-positive|discharge-positive=auto  sign of the current in the file
    <channels>
<tests>
    --hppc LOG[@...]...  pulse test; @-10 or @temperature_C=-10,soc0=1 says what is known
    --ocv LOG[@...]...  low-rate discharge, charge or both
    --capacity LOG[@...]...  capacity test
    --drive LOG[@...]...  drive log to refine on
<start>
    --soc0 SOC=auto  0..1, or auto
<start std>
    --soc0-std S  standard deviation of the initial SOC (of a stated --soc0 0.15 unless given)
<sensor>
    --sensor F.toml  what the sensors are off by, as TOML [a car's]
<reference>
    --reference-soc0 X  true SOC at the start [by the whole log]
    --reference-capacity-ah X  for the reference by the counter
<ahead>
    --cutoff-v V  cell voltage at which the load stops [model]
    --charge-limit-v V  voltage that a charger holds at one cell [model]
    --charge-end-a A  current at which it ends, of one cell [C/20]
    --display [X=0.1]  a percentage as products show it; a difference fades over X of the charge
    --power  what the cell can give and take within its limits
    --horizons S,S  for how long it is held, in seconds [2,10,30]
    <limits>
    --anyway  forecasts, power and health of what is far off the model, too
<limits>
    --voltage-limits LOW HIGH  of a cell, in volts [model, else its chemistry's]
    --current-limits DISCHARGE CHARGE  without sign, in amperes [the data's]
    --soc-limits LOW HIGH  fractions [0 1]
<page>
    --report F.html  page with pictures
    <figures>
<figures>
    --figures DIR  folder for the pictures as files
    --figure-format png|svg|pdf...  several [png]
<data folder>
    --data DIR  folder of the measured cells [$CELLWISE_DATA]
<fleet>
    <scaled model>
    FOLDER  searched with its subfolders; DIR@temperature_C=25,soc0=1 says it of every log
    -o, --output OUT!  folder of parquet
    --scheduler WHERE=local  local (threads), processes, or a Dask scheduler's address
    --workers N  of this machine [its cores]
    --pattern P=*  of the file names
    --batch N  logs sent together [by their number]
    --fresh  start again, whatever OUT holds
    --retry-failed  try the logs again that have failed
<fleet of logs>
    <fleet>
    <start>
    --cache DIR  keep logs as they were read and checked
    <log options>
"""
