"""The synthetic HPPC test with a known truth: 135 Hz, ten levels, 0.5C to 3C pairs, 1 mV noise.

Made by the generator of the tests, which sums the RC branches in closed form and shares no code
with the package.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.measured_data import REPOSITORY

CAPACITY_AH = 3.0
LEVELS = tuple(round(0.95 - 0.1 * k, 2) for k in range(10))
PULSE_HZ = 135.0
# The fast rows go on for this long after a switch: with it the test has about 1.4 million rows.
FAST_S = 48.0


def generator() -> ModuleType:
    """The tests' generator as a module."""
    name = "cellwise_synthetic_hppc"
    if name in sys.modules:
        return sys.modules[name]
    file = REPOSITORY / "tests" / "support" / "synthetic.py"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"no generator of synthetic tests at {file}", name=name)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def synthetic_hppc(seed: int = 1) -> Any:
    """The test: ``log``, ``cell`` (its parameters as functions of SOC), ``pulses``."""
    made = generator()
    plan = made.HppcPlan(
        levels=LEVELS,
        rates_c=(0.5, 1.0, 2.0, 3.0),
        order="by-level",
        pulse_s=60.0,
        rest_s=1200.0,
        level_rest_s=3600.0,
        pulse_hz=PULSE_HZ,
        fast_s=FAST_S,
        noise_V=1e-3,
    )
    return made.hppc_log(made.nmc_cell(CAPACITY_AH), plan, rng=np.random.default_rng(seed))
