"""Streams for the tests: pieces as a test cuts them, logs fed sample by sample, a CAN database."""

from __future__ import annotations

import json
import math

import numpy as np

from cellwise.live import Sample
from virtual_tester import logged, planned

DBC = """VERSION ""

BU_: BMS

BO_ 256 BMS_Pack: 4 BMS
 SG_ PackCurrent : 0|16@1- (0.01,0) [-300|300] "A" BMS
 SG_ Alive : 16|4@1+ (1,0) [0|0] "" BMS

BO_ 257 BMS_Voltage: 2 BMS
 SG_ PackVoltage : 7|16@0+ (0.1,0) [0|900] "V" BMS

BO_ 512 BMS_Thermal: 1 BMS
 SG_ BatteryTemp : 0|8@1- (1,-40) [0|0] "degC" BMS

BO_ 2566844672 Cellwise: 4 BMS
 SG_ Soc : 0|16@1+ (0.01,0) [0|100] "%" BMS
 SG_ Mode : 16|8@1+ (1,0) [0|3] "" BMS
"""


class Given:
    """Pieces as a test cuts them."""

    name = "a test"

    def __init__(self, pieces):
        self.pieces = pieces

    def __iter__(self):
        return iter(self.pieces)

    def close(self):
        pass


def driven(model, soc0=0.8, rows=600, seed=0, rest=0):
    """A log of a model's own voltage under a random load."""
    rng = np.random.default_rng(seed)
    load = np.repeat(rng.normal(0.6, 1.0, rows // 10), 10) * model.capacity_Ah
    load[:rest] = 0.0
    log = planned(load, temperature_C=25.0)
    return logged(model, log, soc0)


def samples(log):
    for k in range(len(log)):
        t = log.temperature_C
        warm = math.nan if t is None else float(t[k])
        yield Sample(float(log.time_s[k]), float(log.current_A[k]), float(log.voltage_V[k]), warm)


def json_lines(log, place):
    """A log as a sensor sends it, a line of JSON for each sample; the source to name."""
    names = [n for n in ("time_s", "current_A", "voltage_V", "temperature_C")
             if getattr(log, n) is not None]  # fmt: skip
    rows = zip(*(np.asarray(getattr(log, n)).tolist() for n in names), strict=True)
    place.write_text("".join(json.dumps(dict(zip(names, r, strict=True))) + "\n" for r in rows))
    return f"json:{place}"
