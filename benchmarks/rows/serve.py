"""Runs one foreign row: python serve.py ADAPTER.py [OPTION ...], asked by lines of JSON.

An adapter has a class `Row`: `Row.fit(cell, seed)` gives what is kept (anything that pickles),
`Row(cell, fitted, *options)` a filter with `start(soc0, soc0_std)` and
`step(current_A, voltage_V, temperature_C, dt_s) -> (soc, soc_std, voltage_V)`; what it does not
know is NaN. Current is positive on discharge and flowed during the interval that ends at the
sample, both are means of it; a missing voltage is NaN. Needs numpy and nothing of cellwise.
"""

import importlib.util
import json
import math
import os
import pickle
import sys
import time
import traceback
from pathlib import Path

import numpy as np

REST_S = 60.0  # a current that is missing for longer is taken as a rest
TABLES = ("ocv_V", "r0_ohm", "r1_ohm", "c1_F", "r2_ohm", "c2_F")


class Cell:
    """A cell's tests and what cellwise identified on them.

    `logs`: (role, arrays) of time_s, current_A, voltage_V, temperature_C, soc; `tables`: each of
    shape (temperatures, SOC), on `grid_C` and `soc`.
    """

    def __init__(self, path):
        with np.load(path) as found:
            data = {name: found[name] for name in found.files}
        self.capacity_Ah = float(data["capacity_Ah"])
        self.temperature_C = float(data["temperature_C"])
        self.soc, self.grid_C = data["soc"], data["grid_C"]
        self.tables = {name: data[name] for name in TABLES}
        names = ("time_s", "current_A", "voltage_V", "temperature_C", "soc")
        self.logs = [
            (str(role), {name: data[f"log{k}_{name}"] for name in names})
            for k, role in enumerate(data["roles"])
        ]

    def at(self, temperature_C):
        """The tables over SOC at one temperature."""
        t = float(np.clip(temperature_C, self.grid_C[0], self.grid_C[-1]))
        k = min(int(np.searchsorted(self.grid_C, t, side="right")) - 1, self.grid_C.size - 2)
        part = (t - self.grid_C[k]) / (self.grid_C[k + 1] - self.grid_C[k])
        return {n: (1 - part) * v[k] + part * v[k + 1] for n, v in self.tables.items()}

    def of(self, *roles):
        """Tests of some roles."""
        return [log for role, log in self.logs if role in roles]


def at_period(log, period_s):
    """A test on an even step: mean current and voltage of each interval, as a row sees them."""
    t = np.arange(0.0, log["time_s"][-1], period_s)
    width = np.diff(log["time_s"], prepend=0.0)
    found = {"time_s": t}
    for name in ("current_A", "voltage_V"):
        whole = np.interp(t, log["time_s"], np.cumsum(log[name] * width))
        found[name] = np.diff(whole, prepend=0.0) / period_s
        found[name][0] = log[name][0]
    rows = np.searchsorted(log["time_s"], t, side="right") - 1
    return found | {name: log[name][rows] for name in ("temperature_C", "soc")}


def load(path):
    """The adapter's module."""
    sys.path.insert(0, str(Path(path).parent))
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Row


def fit(row, ask, _options):
    """Fit on a cell's tests; what is kept goes to a file."""
    began = time.process_time()
    fitted = row.fit(Cell(ask["training"]), ask["seed"]) if hasattr(row, "fit") else None
    with open(ask["fitted"] + ".part", "wb") as file:
        pickle.dump(fitted, file)
    os.replace(ask["fitted"] + ".part", ask["fitted"])
    return {"seconds": time.process_time() - began}


def run(row, ask, options, kept={}):  # noqa: B006
    """Step through a log, row after row; between the steps of a period the SOC is counted."""
    if ask["fitted"] not in kept:
        kept.clear()
        with open(ask["fitted"], "rb") as file:
            kept[ask["fitted"]] = row(Cell(ask["training"]), pickle.load(file), *options)
    filt, cell = kept[ask["fitted"]], Cell(ask["training"])
    with np.load(ask["rows"]) as found:
        rows = found["data"].T.tolist()
    told = np.full((3, len(rows)), math.nan)
    filt.start(ask["soc0"], ask["soc0_std"])
    held, missing_s, waited, moved, seen_s, seen_Vs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    soc, std = ask["soc0"], ask["soc0_std"]
    began, least = time.process_time(), ask["period_s"] * (1 - 1e-6)
    for k, (current_A, voltage_V, temperature_C, dt_s) in enumerate(rows):
        missing_s = 0.0 if current_A == current_A else missing_s + dt_s
        held = current_A if current_A == current_A else (held if missing_s <= REST_S else 0.0)
        if voltage_V == voltage_V:
            weight = dt_s or 1e-9
            seen_s, seen_Vs = seen_s + weight, seen_Vs + weight * voltage_V
        waited, moved = waited + dt_s, moved + held * dt_s
        soc -= held * dt_s / (3600.0 * cell.capacity_Ah)
        predicted = math.nan
        if k == 0 or waited >= least:
            mean_A = moved / waited if waited else held
            mean_V = seen_Vs / seen_s if seen_s else math.nan
            soc, std, predicted = filt.step(mean_A, mean_V, temperature_C, waited)
            waited = moved = seen_s = seen_Vs = 0.0
        told[:, k] = soc, std, predicted
    seconds = time.process_time() - began
    np.save(ask["answer"], told)
    return {
        "ns_per_step": 1e9 * seconds / len(rows),
        "process_MB": peak_MB(),
        "state_bytes": int(getattr(filt, "state_bytes", 0)),
    }


def peak_MB():
    """Most memory of this process; what `getrusage` says is its parent's where that had more."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return math.nan
    return next(float(x.split()[1]) / 1024.0 for x in lines if x.startswith("VmHWM"))


def main():
    """Answer until standard input ends; what a library prints goes to standard error."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    row, options = load(sys.argv[1]), sys.argv[2:]
    for line in sys.stdin:
        ask = json.loads(line)
        try:
            answer = {"fit": fit, "run": run}[ask["do"]](row, ask, options)
        except Exception as error:
            traceback.print_exc()
            answer = {"problem": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
