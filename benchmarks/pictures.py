"""The picture at the head of README.md: a hard case, an EKF of filterpy's beside ours.

python -m benchmarks.pictures

A drive at -10 degC that took no part in the fit, cut under load in the middle of the SOC, with a
start that is 30 points wrong.
"""

from __future__ import annotations

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.ablation.panel import of_all_temperatures
from benchmarks.accuracy.cold import PLAIN, cases_at
from benchmarks.measured_data import HOW, REPOSITORY, data_folder
from cellwise.estimate.estimators import make_estimator

PICTURE = REPOSITORY / "docs" / "pictures" / "hero.png"
TAG = "n10"  # -10 degC
WIDTH_IN, HEIGHT_IN, DPI = 9.0, 3.4, 120
LINES = ((PLAIN, "a plain EKF (filterpy)", "tab:orange"), ("ekf", "cellwise, EKF", "tab:blue"))


def main() -> int:
    """Draw it.

    Returns
    -------
    int       1 where there are no measured cells
    """
    data = data_folder()
    if data is None:
        print(f"no measured cells: {HOW}", file=sys.stderr)
        return 1
    model = of_all_temperatures(data)
    _, case, *_ = cases_at(data, model, TAG)  # of the two cuts of NN the harder one
    hours = (case.log.time_s - case.log.time_s[0]) / 3600.0
    figure, ax = plt.subplots(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    for name, called, colour in LINES:
        trace = make_estimator(name, model).run(case.log, case.soc0, case.std)
        at_h = (trace.time_s - case.log.time_s[0]) / 3600.0
        soc, band = 100.0 * trace.soc, 200.0 * trace.soc_std
        ax.fill_between(at_h, soc - band, soc + band, color=colour, alpha=0.2, linewidth=0)
        ax.plot(at_h, soc, color=colour, label=called)
    ax.plot(hours, 100.0 * case.truths[1], color="black", linestyle="--", label="tester's counter")
    ax.set(xlabel="time [h]", ylabel="SOC [%]", xlim=(0.0, hours[-1]), ylim=(0.0, 100.0))
    ax.legend(loc="upper right", frameon=False)
    figure.savefig(PICTURE, dpi=DPI)
    return 0


if __name__ == "__main__":
    sys.exit(main())
