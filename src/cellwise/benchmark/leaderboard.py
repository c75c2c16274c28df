"""Rows of a frozen suite that stand beside each other: kept, checked, drawn in, printed."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.figures import COLUMNS as ROW_COLUMNS
from cellwise.benchmark.standings import (
    BAND_COLUMNS,
    COLUMNS,
    Runs,
    Standing,
    Table,
    by_estimator,
    markdown,
    run_of,
    standings,
    table_of,
)
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.records import need

LEADERBOARD, TABLE = "leaderboard.json", "leaderboard.md"
LIBRARIES = ("numpy", "scipy", "numba")
KEYS: dict[str, type] = {"suite": str, "suite_sha256": str, "made_with": str}
ROW_KEYS: dict[str, type] = {"estimator": str, "runs": list}
# What a row keeps of each of its runs.
RUN_FIGURES: dict[str, type] = {
    name: ROW_COLUMNS[name]
    for name in (
        "log", "fault", "start_error", "dt_s", "soc0_true", "easy", "quick", "settled_rmse",
        "settled_max", "soc_final_error", "convergence_s", "coverage_2sigma", "interval_score",
        "band_width", "ns_per_step", "state_bytes", "process_MB", "problem",
    )
}  # fmt: skip
# Shares and SOC errors: a figure beyond is in another unit.
FRACTIONS = ("settled_rmse", "settled_max", "soc_final_error", "coverage_2sigma")
Entry = Mapping[str, Any]


class Standings(NamedTuple):
    """The standings of a suite, or of its quick cut."""

    title: str
    found: list[Standing]
    tables: tuple[Table, ...]


def provenance() -> str:
    """Versions that the figures depend on."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"cellwise {version('cellwise')}, {libraries}, Python {platform.python_version()}"


def leaderboard(suite: str, suite_sha256: str, rows: Runs, **made_with: Any) -> dict[str, Any]:
    """The runs of every estimator that did all of a frozen suite's, or its quick cut.

    What they amount to is :func:`cellwise.benchmark.standings.standings`.
    """
    every = by_estimator(rows)
    whole = max((frozenset(map(run_of, own)) for own in every.values()), key=len)
    quick = frozenset(run_of(row) for row in rows if row.get("quick"))
    return {
        "suite": suite,
        "suite_sha256": suite_sha256,
        "made_with": provenance(),
        **made_with,
        "rows": [
            {"estimator": name, "runs": [{k: _plain(r.get(k)) for k in RUN_FIGURES} for r in own]}
            for name, own in every.items()
            if (found := set(map(run_of, own))) == whole or (quick and found == quick)
        ],
    }


def _plain(value: Any) -> Any:
    """As JSON has it: a figure that is not known is null."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


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
    _check_kinds(found, KEYS, path.name)
    rows = found.pop("rows", None) or [found.pop("row", None)]
    for row in rows:
        _check_kinds(row, ROW_KEYS, f"a row of {path.name}")
        for run in row["runs"]:
            _check_run(run, f"a run of '{row['estimator']}'")
    submitted = found.pop("submitted", {})
    return [{**found, **submitted.get(row["estimator"], {}), "row": row} for row in rows]


def _check_kinds(found: Any, kinds: Mapping[str, type], where: str) -> None:
    need(isinstance(found, dict), f"a {type(found).__name__} as {where}", "an object")
    for name, kind in kinds.items():
        need(name in found, f"no '{name}' in {where}", f"a {kind.__name__}")
        value = found[name]
        fits = isinstance(value, kind)
        if kind in (int, float):  # a figure that is not known is null
            fits = value is None or (isinstance(value, int | float) and not isinstance(value, bool))
        need(fits, f"{name} = {value!r} in {where}", f"a {kind.__name__}")


def _check_run(run: Any, where: str) -> None:
    _check_kinds(run, RUN_FIGURES, where)
    for name in FRACTIONS:
        fits = run[name] is None or abs(run[name]) <= 1.5
        need(fits, f"{name} = {run[name]} in {where}", "a fraction of SOC or of the rows")
    judged = run["settled_rmse"] is not None or bool(run["problem"])
    need(judged, f"{where} without settled_rmse or a problem", "one of the two")


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
    by_name = {e["row"]["estimator"]: e for e in new}
    entries = [*(e for e in there if e["row"]["estimator"] not in by_name), *new]
    whole = json.loads(kept.read_text(encoding="utf-8"))
    whole["rows"] = [e["row"] for e in entries]
    made = {name: {k: v for k, v in e.items() if k != "row"} for name, e in by_name.items()}
    whole["submitted"] = {**whole.get("submitted", {}), **made}
    write_atomically(kept, json.dumps(whole, indent=1) + "\n")
    write_atomically(folder / TABLE, standings_text(entries))
    return list(by_name)


def _check_runs(row: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> None:
    """The runs are those of another row: of the whole suite, or of its quick cut."""
    names = ("log", "fault", "start_error", "dt_s", "easy", "quick")

    def of(one: Mapping[str, Any], quick: bool) -> list[tuple[Any, ...]]:
        return sorted(tuple(r[n] for n in names) for r in one["runs"] if r["quick"] or not quick)

    own = of(row, False)
    most = max(others, key=lambda one: len(one["runs"]))
    expected, quick = of(most, False), of(most, True)
    need(
        own in (expected, quick),
        f"{len(own)} runs of '{row['estimator']}' that are not the suite's",
        f"each of its {len(expected)} once, or of its {len(quick)} in the quick cut",
        "Run the whole suite with the adapter.",
    )


def parts_of(entries: Sequence[Entry]) -> list[Standings]:
    """The whole suite, then its quick cut with slow rows too."""
    made = {e["row"]["estimator"]: e for e in entries}
    runs = {name: e["row"]["runs"] for name, e in made.items()}
    parts = []
    quick_alone = all(run["quick"] for own in runs.values() for run in own)
    for title, quick in (("Whole suite", False), ("Quick cut", True)):
        found = standings(runs, quick=quick)
        if not found or (quick_alone and not quick):
            continue
        bands = table_of(found, BAND_COLUMNS, (0, 5, 6))
        bands.head.extend(("made with", "by"))
        for one, row in zip(found, bands.rows, strict=True):
            entry = made[one.estimator]
            row.extend((entry["made_with"].partition(",")[0] or "-", entry.get("by", "-")))
        count = sum(r["quick"] or not quick for r in runs[found[0].estimator])
        title = f"{title}: {len(found)} estimators, {count} runs each"
        parts.append(Standings(title, found, (table_of(found, COLUMNS, (1,)), bands)))
    return parts


def standings_text(entries: Sequence[Entry]) -> str:
    """The same as tables in Markdown."""
    lines: list[str] = []
    for part in parts_of(entries):
        lines += [f"#### {part.title}", ""]
        for table in part.tables:
            lines += markdown(table)
    return "\n".join(lines)
