"""Replay a flight: SOC with its band, time and energy to empty. Nobody says the start SOC."""

import cellwise as cw
from cellwise.forecast.remaining import forecast
from cellwise.report import replay_page

tests = cw.TestLogs(
    hppc=((cw.load_dataset("nmc_hppc"), None),), ocv=(cw.load_dataset("nmc_ocv_c20"),)
)
cell = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, refine=False)).model

# Your own: cw.read_log("flight.ulg", series="auto"), or an ArduPilot .bin with series=4.
flight = cw.load_dataset("nmc_flight")
run = cw.replay(cell, flight)
print(run, "| start:", run.start.how)

left = forecast(cell, run, cutoff_V=3.0)
if left is not None:
    now = left.last
    low, high = (seconds / 60 for seconds in now.remaining_s_band)
    print(
        f"{now.remaining_s / 60:.1f} min left ({low:.1f} to {high:.1f}), {now.remaining_Wh:.1f} Wh"
    )
replay_page([run], "flight.html", flights=() if left is None else (left,))
run.to_pandas().to_csv("flight.csv", index=False)
