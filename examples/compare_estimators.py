"""The same drive through several estimators, each 30 points wrong at the start."""

import cellwise as cw

tests = cw.CellTests(
    hppc=cw.load_dataset("nmc_hppc"),
    ocv=cw.load_dataset("nmc_ocv_c20"),
    drive=cw.load_dataset("nmc_drive_a"),
)
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0)).model
drive = cw.load_dataset("nmc_drive_b")

print(f"{'estimator':12s} {'settled RMSE':>12s} {'within 2 %':>11s} {'inside 2 sigma':>15s}")
for name in ("coulomb", "ekf", "ukf", "adaptive"):
    run = cw.replay(cell, drive, name, soc0=0.7, reference_soc0=0.997, reference_capacity_Ah=5.1532)
    took = "never" if run.convergence_s is None else f"{run.convergence_s:.0f} s"
    print(f"{name:12s} {100 * run.settled.rmse:10.2f} % {took:>11s} "
          f"{100 * run.coverage_2sigma:13.1f} %")  # fmt: skip
