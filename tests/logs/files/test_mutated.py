"""Files with damaged bytes, another damage in every run: read, or refused as bad input.

The run's header states the seed; CELLWISE_FUZZ_SEED=N runs the same files again.
"""

from __future__ import annotations

import os
import zlib

import numpy as np
import pytest

from cellwise import read_model, write_model
from cellwise.errors import InputError
from cellwise.logs import read_log, write_log
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from log_files import pulse_channels
from tester_files import table, write_mat5, write_mpr, write_nda, write_ndax
from vehicle_files import write_can, write_dataflash, write_dbc, write_mdf, write_ulog

for library in ("pyulog", "pymavlink", "asammdf", "cantools", "galvani", "fastnda", "h5py"):
    pytest.importorskip(library)

C = pulse_channels(300)
TIDY = {k: C[k] for k in ("time_s", "current_A", "voltage_V")}
GROUP = [(n, u, C["time_s"], C[n]) for n, u in (("current_A", "A"), ("voltage_V", "V"))]
TEXTS = {
    "arbin": {"Test_Time(s)": C["time_s"], "Step_Index": np.ones(300),
              "Current(A)": -C["current_A"], "Voltage(V)": C["voltage_V"]},
    "maccor": {"Rec#": np.arange(300.0), "Test (Sec)": C["time_s"],
               "Amps": np.abs(C["current_A"]), "Volts": C["voltage_V"],
               "State": np.where(C["current_A"] > 0, "D", "R")},
    "leafspy": {"epoch time": C["time_s"], "Pack Volts": 96 * C["voltage_V"],
                "Pack Amps": C["current_A"]},
    "novonix": {"Run Time (h)": C["time_s"] / 3600, "Current (A)": -C["current_A"],
                "Potential (V)": C["voltage_V"]},
}  # fmt: skip
WRITERS = {
    "ulog": lambda p: write_ulog(p, [C]),
    "dataflash": lambda p: write_dataflash(p, [C], "instances"),
    "mdf": lambda p: write_mdf(p, [GROUP]),
    "blf": lambda p: write_can(p, C, "blf"),
    "trc": lambda p: write_can(p, C, "trc"),
    "nda": lambda p: write_nda(p, C),
    "ndax": lambda p: write_ndax(p, C),
    "mpr": lambda p: write_mpr(p, C),
    "mat": lambda p: write_mat5(p, C),
    "parquet": lambda p: write_log(CellLog(**TIDY), p.with_suffix(".parquet")).rename(p),
    "csv.gz": lambda p: write_log(CellLog(**TIDY), p.with_suffix(".csv.gz")).rename(p),
    **{name: lambda p, c=c: p.write_text(table(c)) and p for name, c in TEXTS.items()},
}
TRIES = 6


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Other bytes, bits, a part cut out, doubled or filled, a number made extreme."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(data)))
        length = int(min(rng.integers(1, 64), len(data) - at))
        kind = int(rng.integers(6))
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at : at + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 2:
            del data[at : at + length]
        elif kind == 3:
            data[at:at] = data[at : at + length]
        elif kind == 4:
            data[at : at + 8] = rng.choice([b"\xff" * 8, bytes(8), b"\x7f" + b"\xff" * 7])
        else:
            del data[at:]
        data = data or bytearray(b"\0")
    return bytes(data)


def generator(name: str) -> np.random.Generator:
    return np.random.default_rng([int(os.environ["CELLWISE_FUZZ_SEED"]), zlib.crc32(name.encode())])


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_mutated_log_is_read_or_refused(name, tmp_path, monkeypatch):
    monkeypatch.setenv("CELLWISE_READ_SECONDS", "10")
    content = WRITERS[name](tmp_path / "log").read_bytes()
    options = {"dbc": write_dbc(tmp_path / "b.dbc")} if name in ("blf", "trc") else {}
    rng = generator(name)
    path = tmp_path / "mutated"
    for _ in range(TRIES):
        path.write_bytes(mutated(content, rng))
        try:
            log = read_log(path, **options)
        except InputError as refusal:
            assert refusal.action  # noqa: PT017
        else:
            assert len(log) > 1
            assert np.all(np.isfinite(log.time_s))


def test_a_mutated_model_is_read_or_refused(tmp_path):
    path = tmp_path / "model.json"
    write_model(curved_cell(), path)
    content, rng = path.read_bytes(), generator("model")
    for _ in range(150):
        path.write_bytes(mutated(content, rng))
        try:
            model = read_model(path)
        except InputError as refusal:
            assert refusal.action  # noqa: PT017
        else:
            assert np.all(np.isfinite(model.ocv_V))
            assert model.capacity_Ah > 0
