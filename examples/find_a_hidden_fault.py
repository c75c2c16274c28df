"""A current sensor that adds 0.15 A: found, measured, taken out again."""

from dataclasses import replace

import cellwise as cw

tests = cw.CellTests(hppc=cw.load_dataset("nmc_hppc"), ocv=cw.load_dataset("nmc_ocv_c20"))
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model

# The hidden fault. The counter would reveal it.
good = cw.load_dataset("nmc_drive_b")
logged = replace(good, current_A=good.current_A + 0.15, charge_Ah=None)

found = cw.diagnose(
    cell, logged, baseline=cw.load_dataset("nmc_drive_c"),
    causes=("current_offset", "resistance_scale", "capacity"),
)  # fmt: skip
print(found)
for cause in found.causes:
    print(cause.name, cause.parameters, "95 %:", cause.ci95, "gain:", cause.gain)
print("next test:", found.next_test)
