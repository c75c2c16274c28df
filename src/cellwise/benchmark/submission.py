"""Rows of a leaderboard from elsewhere: checked against what a row is, set beside the others."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.benchmark.leaderboard import BAND_COLUMNS, COLUMNS, RUN_FIGURES, standings
from cellwise.benchmark.records import need
from cellwise.errors import InputError
from cellwise.files import write_atomically

LEADERBOARD, TABLE = "leaderboard.json", "leaderboard.md"
KEYS: dict[str, type] = {"suite": str, "suite_sha256": str, "made_with": str}
ROW_KEYS: dict[str, type] = {"estimator": str, "runs": list}
# Shares and SOC errors: a figure beyond is in another unit.
SHARES = ("settled_rmse", "settled_max", "soc_final_error", "coverage_2sigma")
Entry = Mapping[str, Any]


def read_entries(path: Path) -> list[dict[str, Any]]:
    """The rows of a file, each with what made it: a run's ``leaderboard.json``, or one row's.

    Raises
    ------
    InputError       no JSON; a key that is missing or of another kind; a figure that cannot be one
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"'{path}', which is no row ({error})",
            "the JSON of a row, or a run's leaderboard.json",
            "Correct the path.",
        ) from error
    need(isinstance(found, dict), f"a {type(found).__name__} in '{path.name}'", "an object")
    _check_kinds(found, KEYS, path.name)
    rows = found.pop("rows", None) or [found.pop("row", None)]
    for row in rows:
        need(isinstance(row, dict), f"no row in '{path.name}'", "an object 'row'")
        _check_kinds(row, ROW_KEYS, path.name)
        for run in row["runs"]:
            _check_run(run, f"a run of '{row['estimator']}'")
    submitted = found.pop("submitted", {})
    return [{**found, **submitted.get(row["estimator"], {}), "row": row} for row in rows]


def submit(path: Path, folder: Path) -> list[str]:
    """Check the rows of a file and draw them in beside those of a run; their names.

    A row of a name that is there takes its place. ``leaderboard.json`` and ``leaderboard.md`` of
    the folder are written again.

    Raises
    ------
    InputError       as :func:`read_entries`; another suite or another version of it; other runs
                     than the suite's; no run of the suite in the folder
    """
    kept = folder / LEADERBOARD
    if not kept.is_file():
        raise InputError(
            f"no {LEADERBOARD} in '{folder}'",
            "the folder of a run of the suite, whose rows stand beside",
            "Run it first: cellwise benchmark SUITE -o DIR.",
        )
    there, new = read_entries(kept), read_entries(path)
    for entry in new:
        for key in ("suite", "suite_sha256"):
            need(
                entry[key] == there[0][key],
                f"{key} {entry[key]} of '{entry['row']['estimator']}'",
                there[0][key],
                "Run it on this version of the suite.",
            )
        _check_runs(entry["row"], [e["row"] for e in there])
    names = [e["row"]["estimator"] for e in new]
    entries = [*(e for e in there if e["row"]["estimator"] not in names), *new]
    whole = json.loads(kept.read_text(encoding="utf-8"))
    whole["rows"] = [e["row"] for e in entries]
    whole["submitted"] = {
        **whole.get("submitted", {}),
        **{e["row"]["estimator"]: {k: v for k, v in e.items() if k != "row"} for e in new},
    }
    write_atomically(kept, json.dumps(whole, indent=1) + "\n")
    write_atomically(folder / TABLE, standings_text(entries))
    return names


def standings_parts(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """The whole suite, then its quick cut with slow rows too, as tables."""
    made = {e["row"]["estimator"]: e for e in entries}
    parts = []
    quick_alone = all(run["quick"] for e in entries for run in e["row"]["runs"])
    for title, quick in (("Whole suite", False), ("Quick cut", True)):
        if quick_alone and not quick:
            continue
        found = standings({n: e["row"]["runs"] for n, e in made.items()}, quick=quick)
        if not found:
            continue
        names = [s.estimator for s in found]
        runs = {n: [r for r in made[n]["row"]["runs"] if r["quick"] or not quick] for n in names}
        by = [
            [made[n]["made_with"].partition(",")[0] or "-", made[n].get("by", "-")] for n in names
        ]
        parts.append({
            "title": f"{title}: {len(found)} estimators, {len(runs[names[0]])} runs each",
            "head": [head for head, _ in COLUMNS],
            "cells": [[read(s) for _, read in COLUMNS] for s in found],
            "band_head": [*(head for head, _ in BAND_COLUMNS), "made with", "by"],
            "bands": [[*(read(s) for _, read in BAND_COLUMNS), *more]
                      for s, more in zip(found, by, strict=True)],
            "names": names, "hard": [s.hard for s in found],
            "first": [s.estimator for s in found if s.low == 1],
        })  # fmt: skip
    return parts


def standings_text(entries: Sequence[Entry]) -> str:
    """The same as tables in Markdown."""
    lines: list[str] = []
    for part in standings_parts(entries):
        lines += [f"#### {part['title']}", ""]
        lines += _table(part["head"], part["cells"], text=(1,))
        lines += _table(part["band_head"], part["bands"], text=(0, 7, 8))
    return "\n".join(lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int]) -> list[str]:
    sides = ["---" if k in text else "---:" for k in range(len(head))]
    return [
        "| " + " | ".join(head) + " |",
        "|" + "|".join(sides) + "|",
        *("| " + " | ".join(cells) + " |" for cells in rows),
        "",
    ]


def _check_run(run: Any, where: str) -> None:
    need(isinstance(run, dict), f"{where} that is no object", "an object")
    _check_kinds(run, RUN_FIGURES, where)
    for name in SHARES:
        value = run[name]
        need(
            value is None or abs(value) <= 1.5,
            f"{name} = {value} in {where}",
            "a fraction of SOC or of the rows",
        )
    judged = run["settled_rmse"] is not None and np.isfinite(run["settled_rmse"])
    need(
        bool(run["problem"]) or judged,
        f"{where} without settled_rmse or a problem",
        "one of the two",
    )


def _check_kinds(found: Mapping[str, Any], kinds: Mapping[str, type], where: str) -> None:
    for name, kind in kinds.items():
        need(name in found, f"no '{name}' in {where}", f"a {kind.__name__}")
        value = found[name]
        if kind in (int, float):  # a figure that is not known is null
            fits = value is None or (isinstance(value, int | float) and not isinstance(value, bool))
        else:
            fits = isinstance(value, kind)
        need(fits, f"{name} = {value!r} in {where}", f"a {kind.__name__}")


def _check_runs(row: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> None:
    """The runs are those of another row: of the whole suite, or of its quick cut."""
    names = ("log", "fault", "start_error", "dt_s", "easy", "quick")

    def of(one: Mapping[str, Any], quick: bool) -> list[tuple[Any, ...]]:
        return sorted(tuple(r[n] for n in names) for r in one["runs"] if r["quick"] or not quick)

    own = of(row, False)
    most = max(others, key=lambda one: len(one["runs"]))
    expected = of(most, False)
    need(
        own in (expected, of(most, True)),
        f"{len(own)} runs of '{row['estimator']}' that are not the suite's",
        f"each of its {len(expected)} once, or of its {len(of(most, True))} in the quick cut",
        "Run the whole suite with the adapter.",
    )
