"""Replay a flight: SOC with its band, time and energy to empty, from an unknown initial SOC."""

import cellwise as cw

tests = cw.CellTests(hppc=cw.load_dataset("nmc_hppc"), ocv=cw.load_dataset("nmc_ocv_c20"))
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model

# Your own: cw.read_log("flight.ulg", series="auto"), or an ArduPilot .bin with series=4.
flight = cw.load_dataset("nmc_flight")
run = cw.replay(cell, flight)
print(run, "| start:", run.start.how)

outlook = cw.forecast(cell, run, cutoff_V=3.0)
if outlook is not None:
    now = outlook.last
    low, high = (seconds / 60 for seconds in now.remaining_s_band)
    print(
        f"{now.remaining_s / 60:.1f} min ({low:.1f} to {high:.1f}) and "
        f"{now.remaining_Wh:.1f} Wh remaining"
    )
cw.replay_page([run], "flight.html", flights=() if outlook is None else (outlook,))
run.to_pandas().to_csv("flight.csv", index=False)
