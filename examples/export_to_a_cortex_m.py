"""The filter as C99, ready to compile for a microcontroller."""

from pathlib import Path

import cellwise as cw
from cellwise.cli import main

tests = cw.CellTests(hppc=cw.load_dataset("nmc_hppc"), ocv=cw.load_dataset("nmc_ocv_c20"))
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model
cw.write_model(cell, "cell.json")

# Before it is C: the same bits in Python, with what single precision and the even step cost.
drive = cw.load_dataset("nmc_drive_b")
for estimator in ("ekf", "fixed-step"):
    print(cw.replay(cell, drive, estimator, soc0=0.8))

if main(["export", "--model", "cell.json", "--dt", "1", "-o", "firmware"]) != 0:
    raise SystemExit("the export was refused")
for path in sorted(Path("firmware").iterdir()):
    print(f"{path.stat().st_size:8,d}  {path.name}")
