"""Files of battery testers, written from the layouts of the formats, not by the readers under test.

Every writer takes the channels of `log_files.pulse_channels` (discharge positive, counter discharge
positive) and writes them with the sign, units and names of its instrument.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np


def steps_of(current: np.ndarray) -> np.ndarray:
    """Tester step of every row, from 1: a new one whenever the current changes."""
    return 1 + np.concatenate(([0], np.cumsum(np.diff(current) != 0)))


def step_times(time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Time since the step began, that is since the last row of the step before."""
    begins = np.concatenate(([True], np.diff(steps) != 0))
    starts = np.where(np.arange(time.size) > 0, np.roll(time, 1), time[0])
    return time - np.repeat(starts[begins], np.diff(np.append(np.flatnonzero(begins), time.size)))


def step_counters(charge: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Charge moved since the step began, without sign."""
    begins = np.flatnonzero(np.concatenate(([True], np.diff(steps) != 0)))
    before = np.concatenate(([charge[0]], charge[begins[1:] - 1]))
    return np.abs(charge - np.repeat(before, np.diff(np.append(begins, charge.size))))


def halves(charge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Charge and discharge capacity, both only rising, of a net counter."""
    moves = np.diff(charge, prepend=charge[0])
    return np.cumsum(np.maximum(-moves, 0)), np.cumsum(np.maximum(moves, 0))


def clock(seconds: float, day: bool = False) -> str:
    """``02:03:04.500``, or with days ``0d 02:03:04.500``."""
    minutes, left = divmod(round(seconds, 3), 60)
    hours, minutes = divmod(int(minutes), 60)
    if not day:
        return f"{hours:02d}:{minutes:02d}:{left:06.3f}"
    days, hours = divmod(hours, 24)
    return f"{days}d {hours:02d}:{minutes:02d}:{left:06.3f}"


def table(columns: dict[str, object], sep: str = ",", end: str = "\n") -> str:
    """Lines of text; floats with every digit, words as they are."""
    lines = [sep.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(sep.join(x if isinstance(x, str) else repr(float(x)) for x in row))
    return end.join(lines) + end


def write_nda(path: Path, c: dict[str, np.ndarray]) -> Path:
    """Neware .nda of version 29: a header, then records of 86 bytes in 0.1 mV, 0.1 mA, mA s."""
    steps = steps_of(c["current_A"])
    times = step_times(c["time_s"], steps)
    moved = 1e3 * 3600 * step_counters(c["ampere_hours"], steps)  # mA s
    head = bytearray(2304)
    head[:6] = b"NEWARE"
    head[14] = 29
    records = []
    for k, current in enumerate(c["current_A"]):
        kind = 4 if current == 0 else 2 if current > 0 else 1
        counters = [0, 0]
        counters[0 if current < 0 else 1] = round(10 * moved[k]) if current else 0
        records.append(
            struct.pack("<BBIIHBB", 0x55, 0, k + 1, 0, int(steps[k]), kind, int(steps[k]) % 256)
            + struct.pack("<Q", round(1000 * times[k]))
            + struct.pack("<ii", round(1e4 * c["voltage_V"][k]), round(-1e4 * current))
            + bytes(8)
            + struct.pack("<qqqq", *counters, 0, 0)
            + struct.pack("<HBBBBB", 2024, 5, 1, 12, 0, 0)
            + bytes(1)
            + struct.pack("<i", 1000)  # of a range of 1 A currents count in tenths of a mA
            + bytes(4)
        )
        assert len(records[-1]) == 86
    path.write_bytes(bytes(head) + b"".join(records))
    return path


def _ndc(kind: int, rows: list[bytes], version: int = 14) -> bytes:
    """Pages of 4096 bytes: a bit per row from byte 4, the rows from byte 132."""
    size = len(rows[0])
    per_page = (4096 - 132 - 1) // size
    pages = [bytes([kind, 0, version]).ljust(4096, b"\0")]
    for start in range(0, len(rows), per_page):
        part = rows[start : start + per_page]
        bits = np.packbits(np.arange(per_page) < len(part), bitorder="little").tobytes()
        page = bytearray(4096)
        page[4 : 4 + len(bits)] = bits
        page[132 : 132 + size * len(part)] = b"".join(part)
        pages.append(bytes(page))
    return b"".join(pages)


def write_ndax(path: Path, c: dict[str, np.ndarray]) -> Path:
    """Neware .ndax of version 14: a zip of three .ndc files (values, times, steps)."""
    steps = steps_of(c["current_A"])
    times = step_times(c["time_s"], steps)
    moved = step_counters(c["ampere_hours"], steps)
    main, info = [], []
    for k, current in enumerate(c["current_A"]):
        main.append(struct.pack("<ff", c["voltage_V"][k], -current))
        charged, discharged = (moved[k], 0.0) if current < 0 else (0.0, moved[k])
        info.append(
            struct.pack("<IB", round(1000 * times[k]), 0)
            + struct.pack("<ffff", charged, discharged, 0.0, 0.0)
            + bytes(8)
            + struct.pack("<iIII", 0, 1_700_000_000 + k, int(steps[k]), k + 1)
            + struct.pack("<h", 0)
            + bytes(8)
        )
    begins = np.flatnonzero(np.concatenate(([True], np.diff(steps) != 0)))
    kinds = [4 if i == 0 else 2 if i > 0 else 1 for i in c["current_A"][begins]]
    step = [struct.pack("<II16xB12x", 0, n + 1, kind) for n, kind in enumerate(kinds)]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("VersionInfo.xml", "<root/>")
        file.writestr("data.ndc", _ndc(1, main))
        file.writestr("data_runInfo.ndc", _ndc(18, info))
        file.writestr("data_step.ndc", _ndc(7, step))
    return path


def write_mpr(
    path: Path, c: dict[str, np.ndarray], current: bool = True, counter_V: float | None = None
) -> Path:
    """BioLogic .mpr: a magic line and modules of settings and data; without current, as of GCPL.

    With ``counter_V`` both electrodes are logged, Ewe and Ece, against a reference.
    """
    kinds: dict[int, str] = {4: "<f8", 6: "<f4", 13: "<f8"}  # time/s, Ewe/V, (Q-Qo)/mA.h
    columns = [c["time_s"], c["voltage_V"], -1e3 * c["ampere_hours"]]
    if current:
        kinds[76] = "<f4"  # <I>/mA
        columns.append(-1e3 * c["current_A"])
    if counter_V is not None:
        kinds[9] = "<f4"  # Ece/V
        columns[1] = c["voltage_V"] + counter_V
        columns.append(np.full(c["time_s"].size, counter_V))
    rows = np.zeros(c["time_s"].size, dtype=[(str(k), v) for k, v in kinds.items()])
    for (key, _), values in zip(kinds.items(), columns, strict=True):
        rows[str(key)] = values
    ids = struct.pack(f"<{len(kinds)}H", *kinds)
    data = struct.pack("<IB", rows.size, len(kinds)) + ids
    data = data.ljust(405, b"\0") + rows.tobytes()

    def module(short: bytes, long: bytes, version: int, content: bytes) -> bytes:
        return (
            b"MODULE"
            + short.ljust(10)
            + long.ljust(25)
            + struct.pack("<II", len(content), version)
            + b"05/01/24"
            + content
        )

    magic = b"BIO-LOGIC MODULAR FILE\x1a".ljust(48) + bytes(4)
    settings = module(b"VMP Set", b"VMP settings", 0, bytes(64))
    path.write_bytes(magic + settings + module(b"VMP data", b"VMP data", 2, data))
    return path


def write_mat5(path: Path, c: dict[str, np.ndarray]) -> Path:
    """A MATLAB 5 file with the structure ``meas`` of a Digatron export."""
    from scipy.io import savemat

    savemat(path, {"meas": digatron_columns(c), "note": "a cell"})
    return path


def write_mat73(path: Path, c: dict[str, np.ndarray]) -> Path:
    """The same as MATLAB 7.3 writes it: HDF5 behind a header of 512 bytes."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("meas")
        for name, values in digatron_columns(c).items():
            group.create_dataset(name, data=values[:, None])
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def digatron_columns(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        "Voltage": c["voltage_V"],
        "Current": -c["current_A"],
        "Ah": -c["ampere_hours"],
        "Battery_Temp_degC": c["temperature_C"],
        "Time": c["time_s"],
    }


def far_cell_workbook(path):
    """A workbook of 1.5 kB with one cell in its last column and row."""
    sheet = (
        '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
        '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>1</v></c>'
        "</row></sheetData></worksheet>"
    )
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    parts = {
        "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/'
        'content-types"><Default Extension="xml" ContentType="application/xml"/></Types>',
        "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
        f'relationships"><Relationship Id="r1" Type="{office}/officeDocument" '
        'Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/'
        f'main" xmlns:r="{office}"><sheets><sheet name="a" sheetId="1" r:id="r1"/></sheets>'
        "</workbook>",
        "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/'
        f'package/2006/relationships"><Relationship Id="r1" Type="{office}/worksheet" '
        'Target="worksheets/sheet1.xml"/></Relationships>',
        "xl/worksheets/sheet1.xml": sheet,
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for name, text in parts.items():
            book.writestr(name, text)
    return path
