"""The filter as C99, ready to compile for a microcontroller."""

import cellwise as cw

tests = cw.CellTests(hppc=cw.load_dataset("nmc_hppc"), ocv=cw.load_dataset("nmc_ocv_c20"))
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model

# Before it is C: the same bits in Python, with what single precision and the even step cost.
drive = cw.load_dataset("nmc_drive_b")
for estimator in ("ekf", "fixed-step"):
    print(cw.replay(cell, drive, estimator, soc0=0.8))

for path in cw.export_firmware(cell, "firmware", dt_s=1.0):
    print(f"{path.stat().st_size:8,d}  {path.name}")
