"""Which runs a suite asks for: log x fault x start error x estimator."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cellwise.benchmark.adapter import short_name
from cellwise.benchmark.faults import NONE, Fault, applies
from cellwise.benchmark.suite import Suite
from cellwise.benchmark.suite_logs import JudgedLog


class Run(NamedTuple):
    """One estimator on one log from one start with one fault."""

    log: int
    fault: Fault
    start_error: float
    estimator: str
    dt_s: float | None


def runs_of(suite: Suite, log: int, judged: JudgedLog) -> Iterator[Run]:
    """Runs on one of the suite's logs.

    A start beyond full or empty does not exist and is left out, and so is a fault that the log
    cannot have.
    """
    soc0 = judged.soc0
    chemistry = next(c.chemistry for c in suite.cells if c.name == suite.logs[log].cell)
    for fault in (Fault(NONE), *suite.faults):
        if not applies(fault, chemistry, judged.log):
            continue
        healthy = fault.name == NONE
        starts = suite.start_errors
        if not healthy and not suite.every_start:
            starts = (possible(suite.fault_start_error, soc0),)
        for error in starts:
            if not 0.0 <= soc0 + error <= 1.0:
                continue
            for name in suite.estimators:
                if _wanted(suite, name, fault, error):
                    yield Run(log, fault, error, name, _step(suite, name))


def possible(error: float, soc0: float) -> float:
    """A start error, to the other side where the SOC has no room for it, or none at all."""
    return next((e for e in (error, -error) if 0.0 <= soc0 + e <= 1.0), 0.0)


def is_slow(suite: Suite, name: str) -> bool:
    """Whether an estimator runs on less."""
    return name in suite.slow.estimators or short_name(name) in suite.slow.estimators


def _wanted(suite: Suite, name: str, fault: Fault, error: float) -> bool:
    if not is_slow(suite, name):
        return True
    starts, faults = suite.slow.start_errors, suite.slow.faults
    return (starts is None or error in starts) and (faults is None or fault.name in faults)


def _step(suite: Suite, name: str) -> float | None:
    return (suite.slow.dt_s or suite.dt_s) if is_slow(suite, name) else suite.dt_s
