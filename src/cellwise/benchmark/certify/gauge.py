"""Anybody's gauge behind two functions of C, in a process of its own and within limits.

The functions stand in ``firmware_ref/gauge/cellwise_gauge.h``; ``gauge_main.c`` there calls them.
"""

from __future__ import annotations

import hashlib
import math
import signal
import subprocess
import tempfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.sensor import Sensor
from cellwise.export.c_tables import firmware_folder
from cellwise.export.firmware import compile_c, host_compiler
from cellwise.export.package import LONGEST_STEP_S, model_sha256
from cellwise.records import need
from cellwise.typing import FloatArray

HEADER = "cellwise_gauge.h"
SAVE, RESTART, TORN, UPDATED = 1, 2, 3, 4  # events before a sample, as in gauge_main.c
SAMPLE = np.dtype(
    [(name, "<f4") for name in ("current_A", "voltage_V", "temperature_C", "dt_s")]
    + [("event", "<u4")]
)
MEMORY_BYTES = 256 << 20  # of a gauge, beside what it is handed
SECONDS, SAMPLES_PER_S = 5, 20_000  # of processor time: to begin with, and one more for so many
SLOW = ("SIGXCPU", "SIGALRM", "SIGKILL")  # beyond its processor time, or waiting for ever
CRASHED, ENDED = 64, 122  # codes of gauge_main.c: a signal beyond the first; it left by itself
TOP_SOC = 0.5  # of the R0 in a configuration


class GaugeConfig(NamedTuple):
    """What a gauge begins with: ``gauge_config`` without the time step."""

    capacity_Ah: float
    r0_ohm: float
    soc0: float
    soc: FloatArray
    ocv_V: FloatArray


class Answers(NamedTuple):
    """SOC and deviation after each sample, NaN where there is none, and what went wrong."""

    soc: FloatArray
    std: FloatArray
    problem: str


def gauge_header() -> str:
    """Declarations that a gauge's source includes."""
    return (firmware_folder() / "gauge" / HEADER).read_text(encoding="utf-8")


def config_of(cell: CellModel, soc0: float) -> GaugeConfig:
    """A cell as a gauge's configuration: at 25 degC or what is nearest to it."""
    usual_C = cell.usual_temperature_C
    r0 = np.array([np.interp(TOP_SOC, cell.soc, row) for row in cell.r0_ohm])
    r0_ohm = np.interp(usual_C, cell.temperature_C, r0)
    ocv_V = np.maximum.accumulate(cell.ocv_at(usual_C))
    return GaugeConfig(cell.capacity_Ah, float(r0_ohm), soc0, np.asarray(cell.soc), ocv_V)


@dataclass(frozen=True, eq=False)
class Gauge:
    """A source behind ``gauge_init`` and ``gauge_step``, compiled for this machine.

    Parameters
    ----------
    source : Path
    folder_of : Path or None     whose C is compiled with it, and whose headers it may include
    model : CellModel            of its configuration, and that virtual cells are made of
    dt_s : float                 of its step [s]

    Raises
    ------
    InputError        no such file, no compiler, C that does not compile
    """

    source: Path
    folder_of: Path | None
    model: CellModel
    dt_s: float
    sensor: Sensor | None = None  # as of an export: nobody has stated one
    _built: Any = field(default_factory=lambda: tempfile.TemporaryDirectory(prefix="gauge-"))

    def __post_init__(self) -> None:
        need(
            math.isfinite(self.dt_s) and 0.0 < self.dt_s <= LONGEST_STEP_S,
            f"a time step of {self.dt_s:g} s",
            f"above zero and up to {LONGEST_STEP_S:g} s",
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """It is compiled again where it is unpacked: in another process, or on another machine."""
        return Gauge, (self.source, self.folder_of, self.model, self.dt_s)

    @property
    def folder(self) -> Path:
        """Of the source."""
        return self.source.parent

    @cached_property
    def description(self) -> dict[str, Any]:
        """What the certificate says of it."""
        return {
            "gauge": self.source.stem,
            "gauge_sha256": hashlib.sha256(b"".join(p.read_bytes() for p in self._files))
            .hexdigest(),
            "model": self.model.name,
            "model_sha256": model_sha256(self.model),
            "options": {},
            "noise": {},
        }  # fmt: skip

    @cached_property
    def _files(self) -> list[Path]:
        """What is compiled: the source first."""
        others = sorted(self.folder_of.glob("*.c")) if self.folder_of else []
        own = self.source.resolve()
        return [self.source, *(path for path in others if path.resolve() != own)]

    @cached_property
    def program(self) -> Path:
        """The compiled program."""
        if not self.source.is_file() or (self.folder_of and not self.folder_of.is_dir()):
            raise InputError(
                f"no gauge at '{self.source}' with '{self.folder_of or self.folder}'",
                "a C source with gauge_init and gauge_step, and the folder of what it includes",
                "Their declarations are in cellwise_gauge.h, which `cellwise certify` writes.",
            )
        shipped, made = firmware_folder() / "gauge", Path(self._built.name) / "gauge"
        folders = [f"-I{path}" for path in (shipped, self.folder, self.folder_of) if path]
        sources = map(str, [shipped / "gauge_main.c", *self._files])
        compile_c([*host_compiler(), "-w", *folders, "-o", str(made), *sources, "-lm"])
        return made

    def run(
        self, config: GaugeConfig, samples: NDArray[Any], updated: GaugeConfig | None = None
    ) -> Answers:
        """Step the gauge through samples.

        Parameters
        ----------
        config : GaugeConfig              what it begins with
        samples : (n,) of SAMPLE
        updated : GaugeConfig or None   its configuration from an event UPDATED on

        Returns
        -------
        Answers                  a crash, a hang, too much memory are a problem with its sample
        """
        samples = np.ascontiguousarray(samples, dtype=SAMPLE)
        most_s = SECONDS + samples.size // SAMPLES_PER_S
        shared = samples.nbytes + 8 * samples.size
        points = config.soc.size
        head = np.array([samples.size, points, most_s, MEMORY_BYTES + shared], dtype="<u4")
        with tempfile.TemporaryDirectory(prefix="life-") as name:
            life, answers = Path(name) / "life", Path(name) / "answers"
            both = [self._config(one, config) for one in (config, updated or config)]
            life.write_bytes(b"".join((head.tobytes(), *both, samples.tobytes())))
            answers.write_bytes(np.full(2 * samples.size, np.nan, dtype="<f4").data)
            command = [str(self.program), str(life), str(answers)]
            silent = subprocess.DEVNULL
            code = subprocess.run(
                command, stdin=silent, stdout=silent, stderr=silent, check=False
            ).returncode
            found = np.fromfile(answers, dtype="<f4").reshape(-1, 2).astype(np.float64)
        return Answers(found[:, 0], found[:, 1], _problem(code, found[:, 0]))

    def _config(self, one: GaugeConfig, first: GaugeConfig) -> bytes:
        ocv_V = np.interp(first.soc, one.soc, one.ocv_V)
        numbers = [one.capacity_Ah, one.r0_ohm, one.soc0, self.dt_s, *first.soc, *ocv_V]
        return np.array(numbers, dtype="<f4").tobytes()


def _problem(code: int, soc: FloatArray) -> str:
    """What kept a gauge from an answer to every sample; empty: nothing."""
    silent = np.flatnonzero(~np.isfinite(soc))
    if not code and not silent.size:
        return ""
    where = f"at sample {silent[0] if silent.size else soc.size} of {soc.size}"
    if not code:
        return f"said no number {where}"
    if code == ENDED:
        return f"ended {where}"
    if code > CRASHED:
        name = signal.Signals(code - CRASHED).name
        return f"took too long {where}" if name in SLOW else f"crashed {where} ({name})"
    return f"could not be run (code {code})"
