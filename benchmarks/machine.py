"""The machine that a figure was measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("cellwise", "numpy", "numba", "scipy", "pyarrow", "filterpy", "pybamm", "thevenin")


def describe_machine() -> dict[str, Any]:
    """Processor, cores this process may use, load of others, versions."""
    return {
        "processor": _processor(),
        "cores": usable_cores(),
        "load": _load(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "blas_threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        **{name: _version(name) for name in PACKAGES},
    }


def machine_lines(machine: dict[str, Any]) -> list[str]:
    """The same as text."""
    packages = ", ".join(f"{name} {machine[name]}" for name in PACKAGES if machine[name])
    load = "" if machine["load"] is None else f", load average {machine['load']:.1f}"
    return [
        f"Machine: {machine['processor']}, {machine['cores']} cores{load}, {machine['system']}, "
        f"{machine['blas_threads']} BLAS thread(s)",
        f"Python {machine['python']}, {packages}",
    ]


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _load() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
