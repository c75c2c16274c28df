"""One page of every kind, from records made by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from cellwise.benchmark.figures import COLUMNS
from cellwise.benchmark.page import benchmark_page
from cellwise.benchmark.suite import Suite
from cellwise.report.capacity_study_page import capacity_study_page
from cellwise.report.diagnosis.page import diagnose_page
from cellwise.report.export_page import export_page
from cellwise.report.identification.page import identify_page
from cellwise.report.replay.page import replay_page
from cellwise.studies.capacity_study import CellStudy, ChoiceResult, SocFigures
from report_cases import drive, identification, replay, simulation

ESTIMATORS = ("ekf", "ukf", "coulomb")
LOGS = ("US06", "cold <b> & long")
FAULTS = ("none", "offset +3 % of 1C", "voltage +30 mV")
KINDS = ("identify", "replay", "diagnose", "benchmark", "capacity-study", "export")


def every_page(folder, diagnosis):
    """Kind to the path of its page."""
    log = drive()
    odd = replace(replay(log), log=replace(log, name="</script><b>odd & name"))
    make = {
        "identify": lambda p: identify_page(identification(), p),
        "replay": lambda p: replay_page([replay(log), odd], p, [simulation(log)]),
        "diagnose": lambda p: diagnose_page(diagnosis, p),
        "benchmark": lambda p: benchmark_page(
            Suite(name="by hand", about="made <by> hand"), benchmark_rows(), p
        ),
        "capacity-study": study_page,
        "export": lambda p: export_page(exported(), p, simulation(log)),
    }
    return {kind: make[kind](folder / f"{kind}.html") for kind in KINDS}


def benchmark_rows():
    """Three estimators, two logs, three faults, three starts."""
    rows = []
    for e, estimator in enumerate(ESTIMATORS):
        for g, log in enumerate(LOGS):
            for f, fault in enumerate(FAULTS):
                for start in (-0.3, 0.0, 0.3):
                    rows.append(row(estimator, log, fault, start, 0.01 * (1 + e + g + f), g))
    return rows


def row(estimator, log, fault, start, rmse, warm):
    blank = {int: 1, float: 0.5, str: "", bool: False}
    told = {name: blank[kind] for name, kind in COLUMNS.items()}
    return told | {
        "suite": "by hand", "cell": "a cell", "log": log, "estimator": estimator, "fault": fault,
        "start_error": start, "settled_rmse": rmse, "settled_max": 3 * rmse, "soc_rmse": 2 * rmse,
        "convergence_s": 100.0 * (1 + abs(start)), "temperature_C": 25.0 - 25.0 * warm,
        "coverage_2sigma": 0.95, "nis_mean": 0.9, "ns_per_step": 90.0,
    }  # fmt: skip


def study_page(path):
    """Three capacities of one cell."""
    rows = (
        ("nominal", 2.8, 0.012, 0.04),
        ("rate:C/20", 3.0, 0.01, 0.002),
        ("rate:1C", 2.9, 0.011, 0.02),
    )
    choices = []
    for choice, capacity, voltage, soc in rows:
        sizes = {"voltage": voltage, "coulomb": soc, "ekf": 0.5 * soc}
        filters = ("coulomb", "ekf")
        choices.append(
            ChoiceResult(
                choice=choice,
                capacity_Ah=capacity,
                fit_rmse_V=voltage,
                voltage_rmse_V=voltage,
                voltage_above_10pct_V=voltage,
                soc={e: SocFigures(*[sizes[e]] * 4, axis_share=0.9) for e in filters},
                errors={kind: (np.full(100, size),) for kind, size in sizes.items()},
            )
        )
    study = CellStudy("cell <1>", 3.0, "by hand", ("log",), tuple(choices), 1.0)
    return capacity_study_page([study], path)


def exported():
    """What the command tells of an export."""
    cost = {
        "core": "cortex-m4f", "text_bytes": 7200, "ram_bytes": 0, "state_bytes": 96,
        "model_bytes": 5200, "stack_bytes": 320, "instructions_mean": 720.0,
        "instructions_most": 1500.0, "measured": 4000,
    }  # fmt: skip
    other = {**cost, "core": "cortex-m0plus", "text_bytes": 12800, "instructions_mean": 14000.0}
    told = {
        "model": "cell <1>",
        "model_sha256": "ab" * 32,
        "dt_s": 1.0,
        "options": {"points": 51, "temperatures": 1, "third": True, "hysteresis": False},
        "states": 4,
        "model_bytes": 5200,
        "state_bytes": 96,
        "input_bytes": 20,
        "output_bytes": 24,
        "targets": [cost, other],
        "accuracy": [
            {"points": n, "flash_bytes": 100 * n, "soc_rmse": 0.3 / n**2, "soc_max": 1.0 / n**2}
            for n in (11, 21, 51, 101)
        ],
        "files": ["cell_table.c", "cell_table.h", "cellwise_ekf.c"],
    }
    return json.loads(json.dumps(told))
