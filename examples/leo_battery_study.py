"""A satellite in low orbit: how sure is SOC after a day without a rest, and with a poor sensor."""

from dataclasses import replace

import numpy as np

import cellwise as cw

tests = cw.CellTests(hppc=cw.load_dataset("nmc_hppc"), ocv=cw.load_dataset("nmc_ocv_c20"))
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model
orbits = cw.load_dataset("nmc_leo")
print(orbits)

# From the right start: how deep the eclipses go.
known = cw.replay(cell, orbits, soc0=0.997)
print(f"SOC from {known.soc.min():.2f} to {known.soc.max():.2f} in twelve orbits")
print(f"lowest voltage {np.nanmin(orbits.voltage_V):.3f} V, allowed {cell.voltage_min_V} V")

# Twenty points wrong at the start, the second time with a sensor that adds 50 mA. The judge is the
# tester's counter, which the sensor does not touch.
poor = replace(orbits, current_A=orbits.current_A + 0.05)
print(f"{'estimator':10s} {'good sensor':>14s} {'50 mA too much':>16s}  (settled SOC RMSE)")
for name in ("coulomb", "ekf", "adaptive"):
    settled = []
    for log in (orbits, poor):
        run = cw.replay(
            cell, log, name, soc0=0.8, soc0_std=0.2,
            reference_soc0=0.997, reference_capacity_Ah=5.1532,
        )  # fmt: skip
        settled.append(100 * run.settled.rmse)
    print(f"{name:10s} {settled[0]:12.2f} % {settled[1]:14.2f} %")
known.plot().savefig("leo.svg")
