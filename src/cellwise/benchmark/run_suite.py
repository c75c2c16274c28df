"""Run a suite: models, then every run, in processes; rows kept as they come, so that it resumes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cellwise.benchmark.adapter import is_adapter, load_adapter, short_name
from cellwise.benchmark.figures import COLUMNS
from cellwise.benchmark.known_logs import file_digest
from cellwise.benchmark.leaderboard import (
    LEADERBOARD,
    TABLE,
    leaderboard,
    parts_of,
    provenance,
    standings_text,
)
from cellwise.benchmark.package_rows import (
    NotRun,
    RowError,
    adapters_folder,
    close_rows,
    environment,
    row_digest,
)
from cellwise.benchmark.row_store import KeptRows, key_of
from cellwise.benchmark.standings import by_estimator, latex, standings
from cellwise.benchmark.suite import Suite
from cellwise.benchmark.suite_logs import check_files, has_own_files, judged_log, locate
from cellwise.benchmark.work import (
    SEED,
    BenchmarkRun,
    SuiteFolders,
    make_model,
    marks,
    run_all,
    runs_of,
)
from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.logs.writing import write_columns
from cellwise.wording import arg

if TYPE_CHECKING:
    from cellwise.report.page.picture import FigureFiles

T = TypeVar("T")
Progress = Callable[[str, int, int], None]
KEPT = "rows.jsonl"


@dataclass(frozen=True, eq=False)
class BenchmarkResult:
    """Rows of a suite, in the suite's order, and where they were written.

    Every row holds the columns of :data:`cellwise.benchmark.figures.COLUMNS`.
    """

    suite: Suite
    rows: tuple[dict[str, Any], ...]
    parquet: Path
    page: Path | None
    resumed: int

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "suite": self.suite.name,
            "rows": list(self.rows),
            "resumed": self.resumed,
            "parquet": str(self.parquet),
            "page": None if self.page is None else str(self.page),
        }


def run_suite(
    suite: Suite,
    folder: Path | str,
    *,
    data: Path | None = None,
    processes: int = 1,
    fresh: bool = False,
    page: bool = True,
    figures: FigureFiles | None = None,
    progress: Progress | None = None,
    adapters: Path | None = None,
) -> BenchmarkResult:
    """Run a suite and write ``results.parquet`` and ``index.html``.

    Rows that an earlier run left in the folder are taken over where suite, data and version are
    the same; they are written as they come, so an interrupted run goes on where it stopped.

    Parameters
    ----------
    folder : Path          of the results
    data : Path or None    folder of the measured cells
    processes : int        1: in this process
    fresh : bool           forget what an earlier run left
    page : bool            write the page as well (needs matplotlib)
    figures : FigureFiles  where the page's pictures go as files
    progress : callable    called with (what, done, total)
    adapters : Path        folder of the rows' adapters; None: this repository's

    Raises
    ------
    InputError        a log, a model or an adapter that is missing; a log that was identified on;
                      nothing to run; a folder that cannot be written to
    """
    say = progress or (lambda what, done, total: None)
    for name in filter(is_adapter, suite.estimators):
        load_adapter(name, suite.folder)
    check_files(suite, data)
    if processes < 1:
        raise InputError(f"{processes} processes", "at least one", "Give e.g. 2.")
    place = SuiteFolders(suite, data, made_folder(folder, "the results"))
    made_folder(place.folder / "models", "the models")
    if fresh:
        (place.folder / KEPT).unlink(missing_ok=True)
    place = _with_rows(place, adapters, say)
    suite = place.suite
    keys = {c.name: _cell_key(place, k) for k, c in enumerate(suite.cells)}
    digests = {row.name: row_digest(row, place.adapters) for row in suite.rows}
    digests |= _adapter_digests(suite)
    runs = _every_run(suite, data)
    kept = KeptRows(place.folder / KEPT, COLUMNS)
    logs = [file_digest(locate(g.log, suite, data)) for g in suite.logs]
    names = {
        r: _run_key(place, r, keys[suite.logs[r.log].cell], logs[r.log], digests) for r in runs
    }
    todo = [run for run in runs if names[run] not in kept.rows]
    resumed = len(runs) - len(todo)
    with _pool(processes) as pool:
        wanted = {suite.logs[run.log].cell for run in todo}
        models = [(k, c.name) for k, c in enumerate(suite.cells) if c.name in wanted]
        making = [(place, k, keys[name]) for k, name in models]
        for done, (_, name) in enumerate(_answers(pool, make_model, making)):
            say(f"model of {name}", done + 1, len(models))
        done = resumed
        say("runs", done, len(runs))
        order = {row.name: k + 1 for k, row in enumerate(suite.rows)}
        todo.sort(key=lambda r: order.get(r.estimator, 0))  # a row's process is kept for its runs
        groups = [tuple(g) for _, g in groupby(todo, key=lambda r: _task(r, order))]
        tasks = [(place, group, keys[suite.logs[group[0].log].cell]) for group in groups]
        for group, rows in _answers(pool, run_all, tasks):
            kept.add({names[run]: row for run, row in zip(group[1], rows, strict=True)})
            done += len(rows)
            say(f"{rows[-1]['log']}, {rows[-1]['fault']}", done, len(runs))
    close_rows()
    found = [kept.rows[names[run]] | marks(suite, run) for run in runs]
    return _finish(place, found, resumed, page, figures)


def _task(run: BenchmarkRun, order: dict[str, int]) -> tuple[Any, ...]:
    """Runs that are one task: of a log and a fault, of a row of another package all of a log."""
    if run.estimator in order:
        return run.estimator, run.log
    return "", run.log, run.fault, run.dt_s


def _with_rows(place: SuiteFolders, adapters: Path | None, say: Progress) -> SuiteFolders:
    """The place with a Python for every row of another package; what cannot be had is not run."""
    suite, where = place.suite, adapters_folder(adapters)
    ready, pythons, missing = [], [], list(suite.not_run)
    for k, row in enumerate(suite.rows):
        try:
            if where is None:
                raise RowError("no folder of adapters (benchmarks/rows of the repository)")
            say(f"environment of {row.name}", k, len(suite.rows))
            pythons.append((row.name, environment(row, (place.folder / "environments").resolve())))
            ready.append(row)
        except RowError as error:
            missing.append(NotRun(row.name, str(error)))
    suite = replace(suite, rows=tuple(ready), not_run=tuple(missing))
    return place._replace(suite=suite, adapters=where or Path(), pythons=tuple(pythons))


def _finish(
    place: SuiteFolders,
    kept: Sequence[dict[str, Any]],
    resumed: int,
    page: bool,
    figures: FigureFiles | None,
) -> BenchmarkResult:
    rows = tuple({name: row[name] for name in COLUMNS} for row in kept)
    columns = {name: [row[name] for row in rows] for name in COLUMNS}
    parquet = write_columns(columns, place.folder / "results.parquet")
    known = {n: [None if v != v else v for v in values] for n, values in columns.items()}
    made = {"seed": [SEED] * len(rows), "made_with": [provenance()] * len(rows)}
    write_columns(known | made, place.folder / "results.csv")
    about = f"Suite {place.suite.name}, {len(rows)} runs. {provenance()}"
    found = standings(by_estimator(rows), fewer=True)
    write_atomically(place.folder / "results.tex", latex(found, about))
    suite, entries = place.suite, []
    if suite.frozen:
        board = leaderboard(
            suite.name,
            suite.sha256,
            rows,
            seed=SEED,
            data="the suite's own files" if has_own_files(suite, place.data) else "same content",
            adapters={short_name(n): d for n, d in _adapter_digests(suite).items()},
            not_run={one.name: one.why for one in suite.not_run},
            about={row.name: row.about for row in suite.rows},
        )
        write_atomically(place.folder / LEADERBOARD, json.dumps(board, indent=1) + "\n")
        entries = [{**board, "row": row} for row in board["rows"]]
        write_atomically(place.folder / TABLE, standings_text(entries))
    written = None
    if page:
        from cellwise.benchmark.page import benchmark_page

        parts = parts_of(entries)
        written = benchmark_page(suite, rows, place.folder / "index.html", parts, figures=figures)
    return BenchmarkResult(place.suite, rows, parquet, written, resumed)


def _adapter_digests(suite: Suite) -> dict[str, str]:
    """SHA-256 of the file of every adapter that is in one."""
    files = {}
    for name in filter(is_adapter, suite.estimators):
        place = Path(name.rpartition(":")[0])
        files[name] = next((f for f in (suite.folder / place, place) if f.is_file()), None)
    return {name: file_digest(file) for name, file in files.items() if file is not None}


def _every_run(suite: Suite, data: Path | None) -> list[BenchmarkRun]:
    runs: list[BenchmarkRun] = []
    for k, one in enumerate(suite.logs):
        runs += runs_of(suite, k, judged_log(one, suite, data))
    if not runs:
        raise InputError(
            "no run at all: every start error leads beyond full or empty",
            "start errors that leave the SOC between 0 and 1",
            "Add 0.0 or a negative one.",
        )
    return list(dict.fromkeys(runs))


def _cell_key(place: SuiteFolders, number: int) -> str:
    """Name of a model that changes with whatever it is made from."""
    cell = place.suite.cells[number]
    locations = (*cell.tests, *([cell.model] if cell.model else []))
    files = [file_digest(locate(p, place.suite, place.data)) for p in locations]
    return key_of([asdict(cell), files, version("cellwise")])


def _run_key(
    place: SuiteFolders, run: BenchmarkRun, cell_key: str, log: str, digests: dict[str, str]
) -> str:
    one, adapter = place.suite.logs[run.log], digests.get(run.estimator, "")
    named = replace(one, log="")
    rest = [asdict(named), log, asdict(run.fault), *run[2:], place.suite.soc0_std]
    return key_of([cell_key, place.suite.name, adapter, *rest])


@contextmanager
def _pool(processes: int) -> Iterator[Executor | None]:
    """Spawned processes (a fork would copy the threads of the bar); None: this one."""
    if processes == 1:
        yield None
        return
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"))
    try:
        yield pool
    except BrokenProcessPool as error:
        raise InputError(
            "a process that ended before its work was done",
            "memory for every process",
            "Run with " + arg("processes", 1) + "; what is done is kept.",
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _answers(
    pool: Executor | None, work: Callable[..., T], tasks: Iterable[tuple[Any, ...]]
) -> Iterator[tuple[tuple[Any, ...], T]]:
    """Tasks with their answers, as they come."""
    if pool is None:
        for task in tasks:
            yield task, work(*task)
        return
    waiting: dict[Future[T], tuple[Any, ...]] = {pool.submit(work, *t): t for t in tasks}
    for future in as_completed(waiting):
        yield waiting[future], future.result()
